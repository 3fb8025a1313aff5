"""The pairing of I and Q words where what is attached to the radar is far stronger than the target."""

import numpy as np
import pytest

from midspan.radar.chirp import ChirpProfile
from midspan.radar.iq_order import decide_order, weigh_orders
from midspan.radar.layout import ORDERS, Layout, pack
from midspan.simulate.motion.motion import Rest
from midspan.simulate.radar.signal import RadarModel, Reflector, noise_for

PROFILE = ChirpProfile(77e9, 64.985e12, 6e6, 64, 0.01, receivers=2)
# Half a cycle of leakage in a chirp: its ghost at half of the sampling rate is as narrow as a target.
SEEN = (Reflector(2.43, 450.0), Reflector(0.1, 2500.0, ratio=0.0))


def decided(order: str, claimed: str, *, snr_db: float, seed: int) -> str:
    model = RadarModel(SEEN, PROFILE, noise_std=noise_for(900.0, snr_db))
    cube = next(iter(model.blocks(Rest(), 64, rng=np.random.default_rng(seed))))
    layout = Layout(PROFILE, order)
    return decide_order(weigh_orders(pack(cube, layout), layout), claimed, said=True).order


@pytest.mark.parametrize("order", ORDERS)
def test_leakage_near_zero_does_not_overturn_a_pairing_that_is_right(order) -> None:
    for seed in range(6):
        assert decided(order, order, snr_db=-2.5, seed=seed) == order


@pytest.mark.parametrize("order", ORDERS)
def test_a_clear_target_shows_the_pairing_beside_leakage(order) -> None:
    claimed = "QQII" if order[0] == "Q" else "IIQQ"
    for seed in range(3):
        assert decided(order, claimed, snr_db=10.0, seed=seed) == order


def paired(order: str, place: float, *, seed: int, snr_db: float = 18.0):
    """Evidence of one target at a fractional bin of 64, no leakage: 16 is a quarter of the range."""
    rng = np.random.default_rng(seed)
    noise = 10 ** (-snr_db / 20) / np.sqrt(2)
    shape = (64, 1, 1, 64)
    profile = ChirpProfile(77e9, 64.985e12, 6e6, 64, 0.01, receivers=1)
    turn = np.exp(2j * np.pi * (place * np.arange(64) / 64 + rng.random((64, 1, 1, 1))))
    cube = 800 * (turn + noise * (rng.normal(size=shape) + 1j * rng.normal(size=shape)))
    return weigh_orders(pack(cube, Layout(profile, order)), Layout(profile, order))


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("place", [9.0, 13.9, 15.0, 17.2, 18.5, 46.0])
def test_faint_ghosts_tell_the_pairing_of_a_target_near_a_quarter_of_the_range(order, place) -> None:
    # A bin off, the ghosts hold 0.5 % each: 23 dB below the target, 10 dB above the noise of a bin of one frame.
    claimed = "QQII" if order[0] == "Q" else "IIQQ"
    for seed in range(3):
        found = paired(order, place, seed=seed)
        assert order in found.paired()
        assert decide_order(found, claimed, said=True).order == order


@pytest.mark.parametrize("order", ORDERS)
def test_a_target_at_a_quarter_of_the_range_itself_leaves_the_pairing_open_and_that_is_reported(order) -> None:
    found = paired(order, 16.0, seed=0)
    assert found.paired() is None
    decision = decide_order(found, order, said=True)
    assert decision.order == order
    assert not decision.certain
    assert "cannot show whether" in decision.text


def test_ghosts_are_one_of_what_the_wrong_pairing_makes_and_none_of_the_right_one() -> None:
    shares = [paired("IQIQ", 12.0, seed=seed).ghosts for seed in range(8)]
    for (wrong, wrong_std), (right, right_std) in shares:
        # The bins together with the target expect a little more or less than the target's own place: at most 10 %.
        assert wrong == pytest.approx(1.0, abs=0.12)
        assert abs(right) < 5 * right_std
        assert wrong_std < 0.05
