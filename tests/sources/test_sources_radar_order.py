"""The pairing of I and Q words where what is attached to the radar is far stronger than the target."""

import numpy as np
import pytest

from midspan.radar.chirp import ChirpProfile
from midspan.radar.iq_order import decide_order, weigh_orders
from midspan.radar.layout import ORDERS, Layout, pack
from midspan.simulate.motion import Rest
from midspan.simulate.radar import RadarModel, Reflector, noise_for

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
