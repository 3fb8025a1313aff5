"""What README and docs say is there: snippets run, keys and commands are complete, links lead somewhere."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

import midspan
from midspan.cli.main import COMMANDS
from midspan.fusion.methods import METHODS
from midspan.records import Status
from midspan.settings.alarms import AlarmSettings
from midspan.settings.group import GroupSettings
from midspan.settings.keys import section_in
from midspan.settings.load import validate
from midspan.settings.recording import RecordingSettings
from midspan.settings.site import PointSettings, SiteFile
from midspan.sinks.write import FORMATS as WRITTEN
from midspan.sources.accelerometer.formats import FORMATS as CHANNELS
from midspan.vision.tracker import TRACKERS, tracker_settings

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]
TEXTS = {page: page.read_text(encoding="utf-8") for page in PAGES}
REFERENCE = "\n".join(TEXTS[ROOT / "docs" / f"{name}.md"] for name in ("configuration", "reference-keys"))
WRITTEN_PAGES = runpy.run_path(str(ROOT / "tools" / "reference.py"))["PAGES"]
SITE_MODELS = (SiteFile, PointSettings, AlarmSettings, GroupSettings)
ALL = "\n".join(TEXTS.values())

SNIPPET = re.compile(r"<!-- runnable(?: (continued)| with (\w+))? -->\n```python\n(.*?)```", re.DOTALL)
TOML = re.compile(r"```toml\n(.*?)```", re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")


def snippets():
    found = []
    for page, text in TEXTS.items():
        before = ""
        for k, (continued, library, code) in enumerate(SNIPPET.findall(text)):
            before = before + "\n" + code if continued else code
            found.append(pytest.param(before, library, id=f"{page.stem}-{k + 1}"))
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a recording `footbridge/`: 20 s of a small textured wall at 10 Hz, an accelerometer, a laser."""
    from midspan.simulate.motion.motion import Sines
    from midspan.simulate.scene.camera import Camera
    from midspan.simulate.scene.texture import textured_scene

    root = tmp_path_factory.mktemp("docs")
    place = root / "footbridge"
    place.mkdir()
    motion = Sines(np.array([1e-3, 0.6e-3, 0.4e-3]), np.array([1.3, 2.1, 3.4]), phase_rad=np.array([0.0, 1.0, 2.0]))
    rng = np.random.default_rng(0)
    time_s, frame_s = np.arange(0, 20, 0.01), np.arange(0, 19.8, 0.1)
    accel = motion.acceleration(time_s) + rng.normal(0, 2.5e-3, time_s.size)
    np.savetxt(place / "accel.csv", np.column_stack((time_s, accel)), delimiter=",", header="time_s,accel", comments="")
    laser = np.column_stack((time_s, 1e3 * motion.displacement(time_s)))
    np.savetxt(place / "laser.csv", laser, delimiter=",", header="time_s,displacement_mm", comments="")
    scene, camera = textured_scene("natural", (120, 160), rng=rng), Camera()
    shift = motion.displacement(frame_s) / -1.5e-3
    np.savez(
        place / "camera.npz",
        frames=np.array([camera.expose(scene.render(0.0, float(y)), rng=rng) for y in shift]),
        time_s=frame_s,
    )
    (place / "recording.toml").write_text(
        '[accelerometer]\nfile = "accel.csv"\nunit = "m/s^2"\n\n[camera]\nfile = "camera.npz"\n', encoding="utf-8"
    )
    result = midspan.estimate(place)
    for name in ("result.csv", "result.mseed", "result.mat"):
        result.save(root / name)
    two_points(root)
    return root


def two_points(folder):
    """Results of two points of a structure with modes at 1.3 and 3.4 Hz, 1 % of damping, under white force, mm."""
    from scipy.signal import lfilter

    rng = np.random.default_rng(3)
    time_s, step_s = np.arange(0, 600, 0.02), 0.002
    motion = []
    for frequency_hz, rms in ((1.3, 1.0), (3.4, 0.3)):
        omega, damping = 2 * np.pi * frequency_hz, 0.01
        pole = np.exp(step_s * omega * complex(-damping, (1 - damping**2) ** 0.5))
        mode = lfilter([1.0], [1.0, -2 * pole.real, abs(pole) ** 2], rng.normal(size=10 * time_s.size))[::10]
        motion.append(rms * mode / mode.std())
    for name, shape in (("quarter", (0.7, 0.7)), ("middle", (1.0, -1.0))):
        values = np.dot(shape, motion) + rng.normal(0, 0.01, time_s.size)
        np.savetxt(folder / f"{name}.csv", np.column_stack((time_s, values)), delimiter=",",
                   header="time_s,displacement_mm", comments="")  # fmt: skip


@pytest.mark.parametrize(("code", "library"), snippets())
@pytest.mark.filterwarnings("default")  # other libraries' own
def test_every_runnable_snippet_runs(code, library, folder, monkeypatch):
    """library: one that only the recipes need; the developers' extra installs it."""
    if library:
        pytest.importorskip(library)
    monkeypatch.chdir(folder)
    exec(compile(code, "snippet", "exec"), {"__name__": "snippet"})


def test_every_python_block_is_marked_runnable():
    for page, text in TEXTS.items():
        assert text.count("```python") == len(SNIPPET.findall(text)), page


@pytest.mark.parametrize("page", WRITTEN_PAGES, ids=lambda page: page.name)
def test_the_reference_is_what_its_command_writes(page):
    assert page.read_text(encoding="utf-8") == WRITTEN_PAGES[page](), "out of date: `python tools/reference.py`"


@pytest.mark.parametrize("model", [RecordingSettings, *SITE_MODELS], ids=lambda model: model.__name__)
def test_every_key_has_one_short_sentence(model):
    for name, field in model.model_fields.items():
        inner = section_in(field.annotation)
        if inner is not None:
            test_every_key_has_one_short_sentence(inner)
        else:
            # Twenty words are what a line of the table holds.
            assert field.description, f"{model.__name__}.{name}"
            assert len(field.description.split()) <= 20, f"{model.__name__}.{name}"
            assert not field.description.endswith("."), f"{model.__name__}.{name}"


def test_every_example_of_a_recording_or_a_site_is_valid(tmp_path, monkeypatch):
    import tomllib

    from midspan.settings.campaign import CampaignSettings
    from midspan.settings.site import load_site

    whole = {"accelerometer": {"file": "a.csv"}, "camera": {"file": "c.mkv"}}
    blocks = [(page, code) for page, text in TEXTS.items() for code in TOML.findall(text)]
    assert len(blocks) >= 4
    for name in ("MQTT_PASSWORD", "HOOK_SECRET"):
        monkeypatch.setenv(name, "secret")
    for page, code in blocks:
        if code.startswith("[[group]]"):
            code = f'name = "river"\n[store]\npath = "store"\n[mqtt]\n{code}'
        if "[[point]]" in code or "[[group]]" in code:
            (tmp_path / "SITE.toml").write_text(code)
            load_site(tmp_path / "SITE.toml")
            continue
        if "recordings =" in code:
            validate(tomllib.loads(code), str(page), CampaignSettings)
            continue
        validate({**whole, **tomllib.loads(code)}, str(page))


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_is_described(command):
    assert f"`midspan {command}" in TEXTS[ROOT / "docs" / "reference-commands.md"]


def test_no_command_is_described_that_does_not_exist():
    named = set(re.findall(r"(?:^|`|\$ )midspan ([a-z][a-z-]+)", ALL, flags=re.MULTILINE))
    assert named <= set(COMMANDS)


@pytest.mark.parametrize(
    "word", [*METHODS, *TRACKERS, *(s.word for s in Status), "camera", "infrared", "displacement", "prediction"]
)
def test_every_name_of_a_method_tracker_status_and_source_is_in_the_reference(word):
    assert word in REFERENCE


@pytest.mark.parametrize("suffix", sorted({s for row in (*CHANNELS, *WRITTEN) for s in row[1]}))
def test_every_suffix_is_in_the_list_of_formats(suffix):
    assert suffix in TEXTS[ROOT / "docs" / "formats.md"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_relative_links_lead_somewhere(page):
    for link in LINK.findall(TEXTS[page]):
        if not link.startswith(("http://", "https://", "#")):
            assert (page.parent / link.split("#")[0]).exists(), link


def test_equations_name_files_and_functions_that_exist():
    for cell in re.findall(r"`([a-z_]+(?:/[a-z_0-9]+)+\.py)(?:: ([^`]+))?`", TEXTS[ROOT / "docs" / "equations.md"]):
        source = ROOT / cell[0] if cell[0].startswith("tests/") else ROOT / "src" / "midspan" / cell[0]
        assert source.exists(), cell[0]
        text = source.read_text(encoding="utf-8")
        for name in filter(None, cell[1].split(", ")):
            last = name.split(".")[-1]
            assert re.search(rf"^\s*(def|class) {last}\b", text, flags=re.MULTILINE), f"{cell[0]}: {name}"


def test_pictures_of_the_readme_and_the_gallery_are_small():
    # 80 kB: a page that loads at once also on a slow line.
    pages = (ROOT / "README.md", ROOT / "docs" / "gallery.md")
    pictures = {page.parent / link for page in pages for link in LINK.findall(TEXTS[page]) if link.endswith(".png")}
    assert len(pictures) >= 6
    assert max(picture.stat().st_size for picture in pictures) < 80_000


def test_the_changelog_has_an_entry_for_this_version():
    assert f"## [{midspan.__version__}]" in TEXTS[ROOT / "CHANGELOG.md"]


@pytest.mark.parametrize("name", TRACKERS)
def test_every_setting_of_a_tracker_is_in_their_page(name):
    text = TEXTS[ROOT / "docs" / "trackers.md"].split("## Settings of the trackers")[1]
    table = text.split("\n## ")[0]
    for key in tracker_settings(name).__dataclass_fields__:
        assert f"`{key}`" in table, key
