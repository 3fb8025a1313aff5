"""A target between two bins: response, noise and place, against the window itself."""

import numpy as np
import pytest
from radar_cases import SHORT

from midspan.radar.following import between, fraction_between, looked_at, noise_between, response, response_at
from midspan.radar.range_profile import bin_kernel
from midspan.simulate.radar.signal import beat


@pytest.mark.parametrize("distance", [0.0, 0.2, 0.5, 1.0, 1.7, -0.4])
def test_the_scalar_response_is_that_of_arrays(distance: float) -> None:
    assert response_at(distance) == pytest.approx(float(response(np.array(distance))), abs=1e-12)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 0.9])
def test_signal_noise_and_place_between_two_bins_are_those_of_the_window(share: float) -> None:
    kernel = bin_kernel(np.array([20.0, 21.0]), SHORT)
    low, high = kernel @ beat(np.array([(20.0 + share) * SHORT.bin_m]), SHORT)[0]
    value = (1 - share) * low + share * high
    # The window is sampled: 256 points instead of an integral.
    assert abs(value) == pytest.approx(between(share), abs=2e-3)
    assert fraction_between(low, high, value) == pytest.approx(share, abs=2e-3)
    weights = (1 - share) * kernel[0] + share * kernel[1]
    assert np.sum(np.abs(weights) ** 2) / np.sum(np.abs(kernel[0]) ** 2) == pytest.approx(
        noise_between(share), abs=2e-3
    )


def test_a_target_whose_place_is_not_sure_is_looked_for_within_its_reach() -> None:
    bins = np.arange(15.0, 27.0)
    z = (bin_kernel(bins, SHORT) @ beat(np.array([22.3 * SHORT.bin_m]), SHORT)[0]).tolist()
    assert looked_at(z, 15.0, (20.1, 0.2)) == 20.1
    assert looked_at(z, 15.0, (20.1, 3.0)) == pytest.approx(22.3, abs=0.01)
    # Nothing farther than the reach is taken for it.
    assert looked_at(z, 15.0, (17.0, 1.0)) < 19.5
