"""The camera's stage: variances from the frames up to each, any cutting the same, and what may be wrong of a frame."""

import io
import pickle
from dataclasses import fields, is_dataclass, replace
from fractions import Fraction

import numpy as np
import pytest

from lens_cases import ideal_translation
from midspan._core import LIGHT_PX, TEMPLATE_NOISE
from midspan.engine.camera import WARM_UP_FRAMES, CameraChain, Target
from midspan.engine.target_opening import Opening
from midspan.engine.tracking import TargetTracking
from midspan.errors import DataError
from midspan.records import Frame, PixelTrack, PixelTranslation, Prediction, Region, Status
from midspan.simulate.scene.camera import Camera
from midspan.simulate.scene.texture import textured_scene
from midspan.simulate.scene.thermal import ThermalCamera, ThermalView
from midspan.thermal.temperature_range import Expected
from midspan.vision.hybrid import PhaseSettings
from midspan.vision.lens import Lens
from midspan.vision.tracker import open_tracker

COUNT, SHAPE = 60, (140, 160)
TARGETS = (Target(Region(24, 22, 64, 64), "deck"), Target(Region(96, 60, 40, 48), "pier"))
TIME_S = np.arange(COUNT) / 10.0
PATH = 0.5 * np.sin(2 * np.pi * 0.7 * TIME_S) + 0.3 * np.sin(2 * np.pi * 1.3 * TIME_S)
LENS = Lens("pinhole", (300.0, 300.0, 79.5, 69.5), (-0.2, 0.05, 0.0, 0.0), (160, 140))


def film(*, seed=0, gain=1.0, lens_px=0.6, path=PATH):
    """Noisy frames of a texture that moves down by `path` px, ten a second."""
    scene = textured_scene("natural", SHAPE, rng=np.random.default_rng(seed), lens_px=lens_px)
    rng = np.random.default_rng(seed + 1)
    gains = np.broadcast_to(gain, len(path))
    exposed = [
        Camera().expose((g * scene.render(0.0, float(y))).astype(np.float32), rng=rng)
        for y, g in zip(path, gains, strict=True)
    ]
    return as_frames(exposed)


def as_frames(pictures):
    return [Frame(100_000_000 * k, picture, k) for k, picture in enumerate(pictures)]


def compressed(frames, crf):
    """The frames after H.264."""
    import av

    memory = io.BytesIO()
    with av.open(memory, "w", format="matroska") as container:
        stream = container.add_stream("libx264", rate=10, options={"crf": str(crf)})
        stream.height, stream.width = frames[0].pixels.shape
        stream.pix_fmt = "gray"
        for k, frame in enumerate(frames):
            out = av.VideoFrame.from_ndarray(frame.pixels, format="gray")
            out.pts, out.time_base = k, Fraction(1, 10)
            container.mux(stream.encode(out))
        container.mux(stream.encode())
    memory.seek(0)
    with av.open(memory) as container:
        return as_frames([np.ascontiguousarray(f.to_ndarray(format="gray")) for f in container.decode(video=0)])


def untaught(frames, targets=TARGETS, tracker="registration", readout_s=0.0, **opening):
    """A chain that has learned nothing."""
    return CameraChain(frames[0], targets, Opening(tracker, readout_s=readout_s, **opening))


def opened(frames, targets=TARGETS, **settings):
    """A chain that has learned from the first frames."""
    chain = untaught(frames, targets, **settings)
    chain.learn(frames[: chain.frames_to_learn])
    return chain


def expected(frame, chain):
    """What an accelerometer would say."""
    y = float(np.interp(frame.time_ns / 1e9, TIME_S, PATH))
    return [Prediction(0.0, y, 0.5, 0.5)] * len(chain.targets)


def tracked(frames, **settings):
    """One block a target."""
    chain = opened(frames, **settings)
    rows = [chain.push(frame) for frame in frames]
    return chain, [PixelTrack.stack(list(one)) for one in zip(*rows, strict=True)]


def thermal_film():
    scene = textured_scene("natural", SHAPE, rng=np.random.default_rng(2), reach_px=8.0, lens_px=1.0)
    view = ThermalView((scene,), camera=ThermalCamera(shutters_s=(3.2,), closed_s=0.3))
    pictures = view.film(np.column_stack((0.0 * PATH, PATH)), TIME_S, rng=np.random.default_rng(1))
    return as_frames(pictures)


FILMS = {
    "lossless": (film, {}),
    "x264": (lambda: compressed(film(), 23), {}),
    "lens and read-out": (film, {"lens": LENS, "readout_s": 0.01}),
    "hybrid": (film, {"tracker": "hybrid"}),
    "key frames": (film, {"reference": "key-frames"}),
    "temperatures": (thermal_film, {"thermal": True, "reference": "key-frames", "targets": TARGETS[:1]}),
}


def same(one, other):
    """Whether two states or rows are equal to the last bit."""
    if is_dataclass(one):
        return type(one) is type(other) and all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    if isinstance(one, tuple | list):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
    if isinstance(one, float):
        return one == other or (np.isnan(one) and np.isnan(other))
    return one == other


@pytest.fixture(scope="module", params=FILMS)
def case(request):
    """A film, what it is tracked with, all its rows, and the state after each."""
    made, settings = FILMS[request.param]
    frames, rows, states = made(), [], []
    chain = opened(frames, **settings)
    for frame in frames:
        rows.append(chain.push(frame, expected(frame, chain)))
        states.append(pickle.dumps(chain.state))
    return frames, settings, rows, states


def test_a_chain_opened_anew_goes_on_from_a_stored_state_to_the_last_bit(case):
    frames, settings, rows, states = case
    assert any(row.status is Status.TRACKING for row in rows[-1])
    chain = opened(frames, **settings)
    # The cuts lie before, in and after checks of the codec, and in the closed shutter.
    for cut in (33, 1, 16, 17, 50):
        chain.restore(pickle.loads(states[cut - 1]))
        assert same(chain.state, pickle.loads(states[cut - 1]))
        for k in range(cut, min(cut + 10, COUNT)):
            assert same(chain.push(frames[k], expected(frames[k], chain)), rows[k])


def test_a_frame_s_row_does_not_know_of_later_frames(case):
    frames, settings, rows, _ = case
    frames = frames[: WARM_UP_FRAMES + 5]
    chain = untaught(frames, **settings)
    if chain.frames_to_learn <= len(frames):
        chain.learn(frames)
        for frame, row in zip(frames, rows, strict=False):
            assert same(chain.push(frame, expected(frame, chain)), row)


def test_the_settings_of_the_updating_rule_reach_it():
    rule = {"literal": True, "threshold_frames": 7}
    chain = untaught(film(), TARGETS[:1], tracker="template", reference="updating", reference_settings=rule)
    settings = chain.targets[0].tracker.settings
    assert (settings.literal, settings.threshold_frames, settings.average_frames) == (True, 7, 10)


def test_a_tracker_that_learns_by_acceleration_is_taught_with_it_or_not_at_all():
    frames = film()
    felt = Expected(PATH[: len(frames)], "y", (0.3, 2.0))
    settings = PhaseSettings(literal=True, matcher="template")
    chains = [untaught(frames, TARGETS[:1], tracker="hybrid", tracker_settings=settings) for _ in range(2)]
    chains[0].learn(frames)
    chains[1].learn(frames, felt)
    without, taught = (chain.targets[0].tracker.model for chain in chains)
    assert (without.ratios, without.along) == (None, None)
    assert taught.along == 1
    assert taught.r_squared[1] > 0.9
    with pytest.raises(DataError, match="at least 5 frames"):
        chains[1].learn(frames, replace(felt, translation_px=np.full(len(frames), np.nan)))


def test_learning_what_is_usual_leaves_the_translations_as_they_are():
    frames = film()
    taught, other = opened(frames), untaught(frames)
    for frame in frames:
        for one, two in zip(taught.push(frame), other.push(frame), strict=True):
            assert (one.x_px, one.y_px, one.time_ns, one.quality) == (two.x_px, two.y_px, two.time_ns, two.quality)


def test_of_raw_frames_only_the_reference_is_widened_to_its_noise():
    frames = film()
    chain, tracks = tracked(frames)
    for target, track in zip(chain.targets, tracks, strict=True):
        tracker = open_tracker("registration", frames[0], target.region)
        own = PixelTrack.stack([tracker.push(frame) for frame in frames])
        np.testing.assert_array_equal(track.variance_y_px2[1:], own.variance_y_px2[1:])
        usual = np.median(own.variance_y_px2[1:])
        # A median of 27 variances of which each is known to some percent.
        assert track.variance_y_px2[0] == pytest.approx(TEMPLATE_NOISE**2 * usual, rel=0.2)
        assert own.variance_y_px2[0] < 0.25 * usual


@pytest.mark.parametrize("crf", [18, 28])
def test_after_h264_every_frame_from_the_first_one_on_says_the_true_error_to_a_factor_of_two_and_a_half(crf):
    (track,) = tracked(compressed(film(seed=13), crf), targets=TARGETS[:1])[1]
    true = np.sqrt(np.nanmean((track.y_px - PATH)[1:] ** 2))
    std = np.sqrt(track.variance_y_px2)
    assert 0.4 < np.nanmedian(std) / true < 2.5
    # The first frames know what a codec does from having been gone through before.
    assert np.nanmin(std[:8]) > 0.4 * np.nanmedian(std)


def test_a_frame_that_repeats_the_one_before_is_lost():
    frames = film()
    frozen = [replace(frame, pixels=frames[min(k, 30) if k < 36 else k].pixels) for k, frame in enumerate(frames)]
    chain, tracks = tracked(frozen)
    for target, track in zip(chain.targets, tracks, strict=True):
        assert np.flatnonzero(track.status == Status.LOST).tolist() == [31, 32, 33, 34, 35]
        assert np.isnan(track.variance_y_px2[31:36]).all()
        assert target.frozen_frames == 5
    assert np.abs(tracks[0].y_px[36:] - PATH[36:]).max() < 0.05


def test_in_the_dark_nothing_is_looked_for():
    gain = np.where((np.arange(COUNT) >= 40) & (np.arange(COUNT) < 50), 0.01, 1.0)
    frames = film(gain=gain)
    chain = opened(frames)
    rows = [chain.push(frame)[0] for frame in frames]
    assert [k for k, row in enumerate(rows) if row.unseen == "dark"] == list(range(40, 50))
    assert [k for k, row in enumerate(rows) if row.status is Status.LOST] == list(range(40, 50))
    assert chain.targets[0].frozen_frames == 0


def test_where_light_is_cut_off_or_the_focus_is_lost_frames_widen_from_then_on():
    raw = [row.variance_y_px2 for row in tracked(film())[1]]
    bright = np.where(np.arange(COUNT) >= 40, 1.7, 1.0)
    soft = film()[:40] + film(lens_px=2.0)[40:]
    for frames in (film(gain=bright), soft):
        for one, own in zip(tracked(frames)[1], raw, strict=True):
            np.testing.assert_array_equal(one.variance_y_px2[:40], own[:40])
            assert np.median(one.variance_y_px2[41:]) > 1.3 * np.median(own[41:])


def test_light_from_the_side_is_a_variance_of_the_reference():
    scenes = [textured_scene("natural", SHAPE, rng=np.random.default_rng(seed)) for seed in (1, 2)]
    rng, frames = np.random.default_rng(0), []
    for t in range(40):
        angle = 0.6 if t >= 20 else 0.0
        one, other = (scene.render(0.0, 0.0) - 110.0 for scene in scenes)
        picture = 110.0 + np.cos(angle) * one + np.sin(angle) * other + rng.standard_normal(SHAPE)
        frames.append(Frame(t * 1_000_000_000, np.clip(np.rint(picture), 0, 255).astype(np.uint8), t))
    chain = opened(frames, targets=TARGETS[:1])
    rows = [chain.push(frame)[0] for frame in frames]
    more = np.sqrt([row.reference_variance_y_px2 for row in rows])
    # Three of five looks, one a second, are in the new light from frame 22 on; the blocks are not quite orthogonal.
    assert not more[:22].any()
    np.testing.assert_allclose(more[23:], LIGHT_PX * np.sin(0.6), rtol=0.15)


def test_translations_come_through_the_lens_and_are_dated_by_the_target_s_row():
    frames = film()
    plain = tracked(frames)[1]
    behind = tracked(frames, lens=LENS, readout_s=0.02)[1]
    for target, one, other in zip(TARGETS, plain, behind, strict=True):
        middle = target.region.y + 0.5 * (target.region.height - 1)
        late_ns = 0.02e9 * (middle + one.y_px) / (SHAPE[0] - 1)
        np.testing.assert_allclose(other.time_ns - one.time_ns, late_ns, atol=1.0)
        for k in range(COUNT):
            row = [getattr(one, f.name)[k] for f in fields(PixelTrack)]
            ideal = ideal_translation(PixelTranslation(*row), target.region, LENS)
            assert other.y_px[k] == pytest.approx(ideal.y_px, abs=1e-12)
            assert other.variance_y_px2[k] == pytest.approx(ideal.variance_y_px2, rel=1e-12)


def test_a_state_does_not_grow():
    frames, sizes = film(path=np.zeros(8)), []
    chain = opened(frames, targets=TARGETS[1:], tracker="template")
    # At the same place between two checks: when the medians are full, and four checks later.
    first, last = ((64 + more) * 96 + 48 for more in (0, 4))
    for k in range(last + 1):
        chain.push(Frame(33_000_000 * k, frames[k % 8].pixels, k), [Prediction(0.0, 0.0, 0.3, 0.3)])
        if k in (first, last):
            sizes.append(len(pickle.dumps(chain.state)))
    # Counters and stamps take a few bytes more.
    assert abs(sizes[1] - sizes[0]) < 100


@pytest.mark.parametrize("tracker", ["registration", "template"])
def test_frames_in_blocks_give_the_rows_of_frames_one_by_one(tracker):
    path = np.concatenate((PATH, PATH[::-1], np.full(20, 15.0), PATH[:20]))
    frames = film(path=path, lens_px=0.8)
    # A dark frame, one that only repeats the one before, and one in which the target has jumped by 15 px.
    frames[100] = replace(frames[100], pixels=np.zeros(SHAPE, dtype=np.uint8))
    frames[103] = replace(frames[103], pixels=frames[102].pixels)
    one_by_one = opened(frames, tracker=tracker)
    rows = [one_by_one.push(frame) for frame in frames]
    in_blocks = [TargetTracking(chain) for chain in opened(frames, tracker=tracker).targets]
    for cut in range(0, len(frames), 17):
        for target in in_blocks:
            target.push_all(frames[cut : cut + 17])
    for number, target in enumerate(in_blocks):
        for k, row in enumerate(rows):
            assert repr(target.translation(k)) == repr(row[number])
