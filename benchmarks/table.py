"""Plain tables and verdicts of the benchmarks."""

from collections.abc import Sequence


def show(head: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print rows of text and numbers in aligned columns."""
    texts = [[_text(value) for value in row] for row in rows]
    widths = [max(len(line[i]) for line in [list(head), *texts]) for i in range(len(head))]
    for line in [list(head), ["-" * width for width in widths], *texts]:
        print("  ".join(value.rjust(width) for value, width in zip(line, widths, strict=True)))


def _text(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def goal(what: str, measured: float, limit: float, *, unit: str = "", at_least: bool = False) -> bool:
    """Print measured against its goal (at most `limit`, or at least); returns whether it is met."""
    met = measured >= limit if at_least else measured <= limit
    sign = ">=" if at_least else "<="
    print(f"{'ok    ' if met else 'MISSED'}  {what}: {measured:.4g} {unit} (goal {sign} {limit:g} {unit})".rstrip())
    return met


# Source for a child process: its own peak memory in MB. The kernel's ru_maxrss would count what the parent held when it
# forked; VmHWM begins anew with the child's program.
PEAK = """
def peak_mb():
    with open("/proc/self/status") as status:
        return next(int(line.split()[1]) / 1024 for line in status if line.startswith("VmHWM"))
"""
