"""What `import midspan` offers, and what it costs."""

import json
import subprocess
import sys

import pytest

import midspan

HEAVY = ("numba", "pandas", "matplotlib", "scipy", "av", "cv2", "pydantic", "h5py", "pyarrow")


def modules_after(code):
    """Names of the modules that a fresh interpreter has loaded after `code`."""
    program = f"import sys, json\n{code}\nprint(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_public_names_are_sorted_and_at_most_forty():
    names = [name for name in midspan.__all__ if not name.startswith("__")]
    assert names == sorted(names)
    assert len(names) <= 40
    assert len(set(names)) == len(names)


@pytest.mark.parametrize("name", midspan.__all__)
def test_every_public_name_exists_and_explains_itself(name):
    thing = getattr(midspan, name)
    if name != "__version__":
        first = (thing.__doc__ or "").strip().splitlines()
        # A dataclass without a docstring gets its signature from Python, which explains nothing.
        assert first
        assert not first[0].startswith(f"{name}(")


def test_the_names_of_the_five_lines_are_there():
    assert {"open_recording", "calibrate", "estimate", "compare"} <= set(midspan.__all__)
    for method in ("to_pandas", "save", "plot", "report", "_repr_html_"):
        assert callable(getattr(midspan.Result, method))


def test_an_unknown_name_is_an_attribute_error_and_dir_lists_the_public_ones():
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        midspan.nonsense  # noqa: B018
    assert set(dir(midspan)) >= set(midspan.__all__)


def test_importing_midspan_loads_no_heavy_library():
    loaded = modules_after("import midspan")
    assert not loaded & {*HEAVY, "numpy"}


def test_help_of_the_command_line_loads_no_heavy_library_not_even_numpy():
    loaded = modules_after("from midspan.cli.main import run\nassert run(['--help']) == 0")
    assert not loaded & {*HEAVY, "numpy"}


def test_help_of_every_command_loads_no_heavy_library():
    code = "from midspan.cli.main import COMMANDS, run\nassert all(run([name, '--help']) == 0 for name in COMMANDS)"
    assert not modules_after(code) & {*HEAVY, "numpy"}


def test_the_error_tree_carries_the_exit_codes_of_the_contract():
    assert midspan.UsageError.exit_code == 2
    assert midspan.DataError.exit_code == 3
    assert midspan.UntrustedError.exit_code == 4
    for error in (midspan.UsageError, midspan.DataError, midspan.UntrustedError):
        assert issubclass(error, midspan.MidspanError)
