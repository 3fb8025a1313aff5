"""Whether a result's displacement is motion that the accelerometer has felt: sensors that jump make metres of it."""

import numpy as np

from midspan.errors import UntrustedError
from midspan.records import NANOSECONDS, Acceleration, Estimate, Floats
from midspan.signals.stamps import shown

# Rows are compared over windows of this length, s: within it an accelerometer's own errors are micrometres to
# millimetres. A start, its velocity, a bias and its drift are four unknowns.
WINDOW_S, CUBIC = 5.0, 4
# White noise of density S, integrated twice over T, spans this times √(S T³) on average about a parabola.
SPANNED = 0.07
# What is moved by more than this many times all that explains it is no motion: no noise reaches five deviations, and no
# accelerometer that is in use reads a fifth.
UNSHAKEN = 5.0


def refuse_unshaken(rows: Estimate, acceleration: Acceleration) -> None:
    """UntrustedError where the displacement moves by far more than the acceleration shows, and than it usually does.

    Over each WINDOW_S the rows are compared with the acceleration integrated twice, both without the cubic that start
    and bias leave open. Moved is the larger of what the acceleration shows, what noise and band allow, and what is
    usual: an accelerometer that fails makes no such motion, a sensor that jumps does.
    """
    place = np.minimum(np.searchsorted(acceleration.time_ns, rows.time_ns), len(acceleration.time_ns) - 1)
    step_s = float(np.median(np.diff(rows.time_ns))) / NANOSECONDS if len(rows.time_ns) > 1 else np.inf
    count = int(WINDOW_S / step_s)
    parts = len(rows.time_ns) // count if count > CUBIC else 0
    if parts < 2:
        return
    basis = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, count), CUBIC))[0]

    def cut(value: Floats) -> Floats:
        return value[: parts * count].reshape(parts, count)

    def bent(value: Floats) -> Floats:
        return np.asarray(np.sqrt(np.mean((value - value @ basis @ basis.T) ** 2, axis=1)))

    shaken = cut(acceleration.value_m_s2[place])
    seen = bent(step_s**2 * np.cumsum(np.cumsum(shaken - shaken.mean(axis=1, keepdims=True), axis=1), axis=1))
    moved = bent(cut(rows.displacement_m))
    noise = SPANNED * np.sqrt(cut(acceleration.noise_density[place]).max(axis=1) * WINDOW_S**3)
    band = np.mean(np.sqrt(cut(rows.variance_m2)), axis=1)
    allowed = UNSHAKEN * np.max([seen, noise, band, np.full(parts, np.median(moved))], axis=0)
    k = int(np.argmax(moved / allowed))
    if moved[k] > allowed[k]:
        raise UntrustedError(
            f"The displacement moves by {1e3 * moved[k]:.3g} mm rms within {WINDOW_S:g} s from "
            f"{shown(int(rows.time_ns[k * count]))} on, where the acceleration shows {1e3 * seen[k]:.2g} mm and "
            f"{1e3 * float(np.median(moved)):.2g} mm are usual: a sensor jumps, as a GNSS receiver does between fixed "
            "and float solutions, or measures something else from there on. Leave such values out of its file."
        )
