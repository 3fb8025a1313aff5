"""calibration.json: what is written is read back alike, for any calibration and any number of sensors of a kind."""

import json
import math
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import midspan
from midspan.calibration.sensors.camera import CameraCalibration, TargetCalibration
from midspan.calibration.sensors.displacement import DisplacementCalibration
from midspan.calibration.sensors.radar import RadarCalibration, RadarTarget
from midspan.engine.axis import AxisFigures
from midspan.radar.following import Background
from midspan.radar.target import Target
from midspan.records import Region, ScaleFactor, Source, TimeOffset
from midspan.settings.stored.calibration import Calibration, calibration_from_dict
from midspan.vision.lens import Lens


def sized(low, high):
    """Numbers over all orders of magnitude from `low` to `high`."""
    return st.floats(math.log(low), math.log(high)).map(math.exp)


signed = st.tuples(sized(1e-8, 1e5), st.sampled_from((-1.0, 1.0))).map(math.prod)
stds = st.one_of(st.just(0.0), sized(1e-12, 1e3))
offsets = st.builds(TimeOffset, st.floats(-1e9, 1e9), st.one_of(st.just(math.inf), stds))
factors = st.builds(ScaleFactor, signed, stds)
regions = st.builds(Region, *2 * [st.integers(0, 9999)], *2 * [st.integers(1, 9999)])
noises, ratios = sized(1e-12, 1e3), sized(1e-9, 1e9)
words = st.text("abcxyz019-_", min_size=1, max_size=8)
complexes = st.builds(complex, *2 * [st.floats(-1e6, 1e6)])
LENS = Lens("pinhole", (800.0, 810.0, 320.0, 240.0), (0.1, 0.0, 0.0, -0.02), (640, 480), 300.5)

used_targets = st.builds(TargetCalibration, regions, words, factors, noises, ratios)
unused_targets = st.builds(
    TargetCalibration,
    regions,
    words,
    st.one_of(st.none(), factors),
    st.one_of(st.just(math.nan), noises),
    st.just(math.nan),
    st.just(False),
    st.just("moves on its own"),
)
# With a single target in use the camera's own keys are the target's: two stay as they are.
target_lists = st.one_of(
    st.just(()), st.tuples(used_targets, used_targets), st.tuples(used_targets, used_targets, unused_targets)
)


@st.composite
def cameras(draw, source=Source.CAMERA, direction="y"):
    thermal = source is Source.INFRARED
    return CameraCalibration(
        draw(factors), draw(offsets), draw(regions), direction, draw(words), draw(noises), draw(ratios),
        phase_scale_m_per_rad=draw(st.none() | signed),
        targets=draw(target_lists),
        relative_scale_std=draw(st.none() | stds),
        lens=draw(st.sampled_from((None, LENS))),
        source=source,
        temperature_range_c=draw(st.none() | st.just((15.0, 25.5))) if thermal else None,
    )  # fmt: skip


@st.composite
def radars(draw):
    channels = draw(st.integers(1, 4))
    weights = st.lists(complexes, min_size=channels, max_size=channels).map(np.array)
    still = st.lists(complexes, min_size=3, max_size=3).map(np.array)
    backgrounds = st.none() | st.builds(Background, st.just(np.array([4.0, 5.0, 6.0])), still)
    known = {
        "place_bin": st.floats(0.0, 1e4), "range_m": st.just(math.nan) | st.floats(0.1, 1e4),
        "amplitude": sized(1e-3, 1e6), "snr_db": st.just(math.inf) | st.floats(-50.0, 90.0), "weights": weights,
        "disagreement_rad": st.floats(0.0, 3.0), "time_offset_s": st.floats(-9.0, 9.0), "leak": complexes,
        "coherence": st.floats(0.9, 1.0), "noise_m": sized(1e-9, 1.0), "reach_bins": st.floats(0.0, 50.0),
        "background": backgrounds,
    }  # fmt: skip
    factor = {"conversion_factor": signed, "conversion_factor_std": stds}
    used = [RadarTarget(draw(st.builds(Target, **known, **factor))) for _ in range(draw(st.integers(1, 3)))]
    faint = RadarTarget(draw(st.builds(Target, **known)), used=False, reason="faint")
    return RadarCalibration(
        (*used, faint), draw(offsets), draw(ratios), draw(stds), draw(st.floats(1e10, 1e11)), channels
    )


levels = st.floats(-1e3, 1e3)
ends = {"range_low_m_s2": st.sampled_from((-math.inf, -19.6)), "range_high_m_s2": st.sampled_from((math.inf, 19.6))}
usual = st.one_of(st.none(), st.builds(AxisFigures, levels, stds, stds, signed, signed, stds, stds, **ends))
UNSEEN, maybe = ("drift", "step", "gap"), st.one_of(st.just(math.inf), sized(1e-6, 1e3))
displacements = st.one_of(
    st.builds(DisplacementCalibration, noises, offsets, resolution_m=stds),
    st.builds(DisplacementCalibration, noises, offsets, low_m=st.just(-0.008), high_m=st.just(0.0123)),
    st.builds(DisplacementCalibration, noises, offsets),
    # Of what a record tells nothing the size is infinite.
    st.builds(DisplacementCalibration, noises, offsets, **{f"unseen_{what}_m": maybe for what in UNSEEN}),
    st.builds(DisplacementCalibration, noises, offsets, signed, sized(1e-9, 1.0)),
)


def named(sensors):
    """Of one or several sensors of a kind: several have names of their own."""
    return [replace(one, name=f"{one.kind}-{k}") for k, one in enumerate(sensors)] if len(sensors) > 1 else sensors


@st.composite
def calibrations(draw):
    listed = [
        named(draw(st.lists(one, max_size=3))) for one in (cameras(), cameras(Source.INFRARED), radars(), displacements)
    ]
    first = {sensors[0].kind: sensors[0] for sensors in listed if sensors}
    others = tuple(one for sensors in listed for one in sensors[1:])
    across, only = None, [*listed[0], *listed[1]]
    if len(only) == 1 and draw(st.booleans()):
        second = replace(
            draw(cameras(only[0].source, "x")),
            **{key: getattr(only[0], key) for key in ("offset", "tracker", "lens", "temperature_range_c", "region")},
        )
        across = Calibration(draw(noises), draw(signed) * 1e-2, draw(stds), **{second.kind: second}, usual=draw(usual))
    return Calibration(
        draw(noises), draw(signed) * 1e-2, draw(st.just(math.inf) | stds), **first, others=others, across=across,
        warnings=("Check the mounting.",), accelerometer_scale=draw(signed), accelerometer_scale_std=draw(stds),
        usual=draw(usual),
    )  # fmt: skip


def assert_alike(found, expected, place="calibration"):
    """Equal but for the last digits that metres lose as millimetres (and variances as deviations)."""
    if is_dataclass(expected):
        assert type(found) is type(expected), place
        for item in fields(expected):
            if item.name not in ("diagnostics", "created", "version", "own_m"):
                assert_alike(getattr(found, item.name), getattr(expected, item.name), f"{place}.{item.name}")
    elif isinstance(expected, tuple | np.ndarray):
        assert len(found) == len(expected), place
        for k, (one, other) in enumerate(zip(found, expected, strict=True)):
            assert_alike(one, other, f"{place}[{k}]")
    elif isinstance(expected, float):
        assert found == pytest.approx(expected, rel=1e-12, nan_ok=True), place
    else:
        assert found == expected, place


@settings(max_examples=60, deadline=None)
@given(calibrations())
def test_what_is_written_is_read_back_alike_and_written_again_alike(calibration):
    tree = json.loads(json.dumps(calibration.to_dict(), allow_nan=False))
    again = calibration_from_dict(tree)
    assert_alike(again, calibration)
    assert calibration_from_dict(json.loads(json.dumps(again.to_dict()))).sensors[0:0] == ()
    assert [(name, kind) for name, kind, _ in again.sensors] == [(n, k) for n, k, _ in calibration.sensors]
    for name, _, sensor in again.sensors:
        assert again.of(name) is sensor


CAMERA = CameraCalibration(
    ScaleFactor(-1.5e-3, 1e-10), TimeOffset(0.1, 1e-6), Region(1, 2, 30, 40), "y", "template", 0.02, 1.0,
    phase_scale_m_per_rad=4e-4,
)  # fmt: skip
GNSS = DisplacementCalibration(1e-3, TimeOffset(0.0, math.inf))
PAIR = Calibration(
    2e-3, 0.05, camera=replace(CAMERA, name="left"), others=(replace(CAMERA, name="right"),), displacement=GNSS
)


def test_keys_that_are_relied_on_keep_name_and_unit():
    thermal = replace(CAMERA, source=Source.INFRARED, temperature_range_c=(15.0, 25.0))
    tree = Calibration(2e-3, 0.05, camera=CAMERA, infrared=thermal, displacement=GNSS).to_dict()
    for section in (tree["camera"], tree["infrared"]):
        assert section["scale_mm_per_px"] == pytest.approx(-1.5, rel=1e-12)
        assert section["scale_std_mm_per_px"] == pytest.approx(0.01, rel=1e-12)
        assert section["time_offset_s"] == 0.1
        assert section["time_offset_std_s"] == pytest.approx(1e-3, rel=1e-12)
        assert section["roi"] == [1, 2, 30, 40]
        assert section["phase_scale_mm_per_rad"] == pytest.approx(0.4, rel=1e-12)
    assert tree["infrared"]["temperature_range_c"] == [15.0, 25.0]
    assert tree["accelerometer"]["noise_std_m_s2"] == 2e-3
    assert (tree["accelerometer"]["scale"], tree["accelerometer"]["scale_std"]) == (1.0, 0.0)
    assert tree["displacement"]["noise_std_mm"] == 1.0
    assert {"version", "created", "warnings"} <= set(tree)


def test_several_sensors_of_a_kind_are_a_list_with_names():
    tree = json.loads(json.dumps(PAIR.to_dict()))
    assert [section["name"] for section in tree["camera"]] == ["left", "right"]
    assert "name" not in tree["displacement"]
    again = calibration_from_dict(tree)
    assert [name for name, _, _ in again.sensors] == ["left", "right", "displacement"]
    assert again.camera.name == "left"
    assert again.of("right").name == "right"
    assert again.of("camera") is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda tree: tree["camera"][1].pop("name"), r"each of several \[\[camera\]\] a unique name; camera\[2\]"),
        (lambda tree: tree["camera"][1].update(name="left"), "2 have the name 'left'"),
        (lambda tree: tree["camera"][1].update(name="displacement"), "'displacement', which is reserved"),
        (lambda tree: tree["camera"][1].update(name="a b"), r"camera\[2\]\.name = 'a b': must consist of letters"),
        (lambda tree: tree["camera"][1].update(noise_std_px=0), r"camera\[2\]\.noise_std_px = 0: must be from 1e-15"),
        (lambda tree: tree["camera"][1].update(direction="xy", axis="y"), r"camera\[2\]: must hold axis"),
        (lambda tree: tree.update(camera=[]), r"camera = \[\]: must be a section with keys, or a list"),
        (lambda tree: tree.update(camera=[3]), r"camera\[1\]: must be one section"),
    ],
)
def test_a_wrong_list_of_sensors_is_refused_with_its_place(change, words):
    tree = json.loads(json.dumps(PAIR.to_dict()))
    change(tree)
    with pytest.raises(midspan.DataError, match=words) as caught:
        calibration_from_dict(tree, "site/calibration.json")
    assert str(caught.value).startswith("site/calibration.json: ")
    assert str(caught.value).endswith("Run `midspan calibrate` again.")


def test_unknown_keys_are_ignored_everywhere():
    def more(tree):
        if isinstance(tree, dict):
            return {**{key: more(value) for key, value in tree.items()}, "of_another_version": {"x": [1]}}
        return [more(value) for value in tree] if isinstance(tree, list) else tree

    assert_alike(calibration_from_dict(more(PAIR.to_dict())), PAIR)


NONSENSE = (
    None,
    True,
    0,
    -1,
    1e308,
    float("nan"),
    2**62,
    "x",
    "camera",
    "",
    [],
    [1],
    [[]],
    {},
    {"a": 1},
    [{}],
    [{}, {}],
)


def places(tree, place=()):
    """Every place of a tree, its branches too."""
    inner = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    return [place, *(one for key, value in inner for one in places(value, (*place, key)))]


def test_nonsense_anywhere_among_several_sensors_is_a_calibration_or_a_sentence():
    text, said = json.dumps(PAIR.to_dict()), []
    for place in places(json.loads(text))[1:]:
        for value in NONSENSE:
            tree = branch = json.loads(text)
            for key in place[:-1]:
                branch = branch[key]
            branch[place[-1]] = value
            try:
                assert isinstance(calibration_from_dict(tree, "c.json"), Calibration)
            except midspan.DataError as error:
                said.append(str(error))
    assert all(text.startswith("c.json: ") for text in said)
    assert not [text for text in said for word in ("Stored", "pydantic", "Value error", "Input") if word in text]
