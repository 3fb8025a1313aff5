"""The command as a process: signals that stop it, streams that cannot be written, places that are read-only."""

import errno
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import midspan

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="signals, /dev/full and mounts of Linux")

COMMAND = "from midspan.cli.main import main; main()"
SOURCES = Path(midspan.__file__).parents[1]
# Generous: the answer does not depend on it.
PATIENCE_S = 250


def call(arguments, before="", **options):
    """The command in a process of its own, after the lines `before`."""
    kept = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}
    program = [sys.executable, "-c", f"{before}\n{COMMAND}", *arguments]
    return subprocess.run(program, text=True, timeout=PATIENCE_S, check=False, **kept)


def signal_at(moment, number):
    """Lines of a program that sends itself a signal when it first calls `moment`, a function of module os."""
    return f"""
import os
def sent(*arguments, real=os.{moment}, **keywords):
    os.{moment} = real
    os.kill(os.getpid(), {int(number)})
    return real(*arguments, **keywords)
os.{moment} = sent
"""


@pytest.mark.parametrize(
    ("number", "words"),
    [(signal.SIGINT, "interrupted"), (signal.SIGTERM, "stopped by SIGTERM"), (signal.SIGHUP, "stopped by SIGHUP")],
)
def test_a_signal_in_the_middle_of_writing_cleans_up_and_says_so(number, words, tmp_path):
    # Under nohup the tests themselves ignore a hang-up, and so would the command.
    heeded = f"import signal; signal.signal({int(number)}, signal.SIG_DFL)"
    done = call(["simulate", "gnss", "-o", str(tmp_path / "g")], f"{heeded}\n{signal_at('fsync', number)}")
    assert done.returncode == 128 + number
    assert done.stderr == f"midspan: {words}; no partial files were left.\n"
    assert os.listdir(tmp_path) == []


def test_a_signal_between_the_renames_of_a_folder_brings_the_old_one_back(gnss, tmp_path):
    shutil.copytree(gnss, tmp_path / "g")
    before = (tmp_path / "g" / "accel.csv").read_bytes()
    # The first rename has moved the old folder aside when the signal is handled.
    done = call(["simulate", "gnss", "-o", str(tmp_path / "g"), "--seed", "7"], signal_at("rename", signal.SIGTERM))
    assert done.returncode == 143
    assert os.listdir(tmp_path) == ["g"]
    assert (tmp_path / "g" / "accel.csv").read_bytes() == before


def test_a_signal_that_the_caller_ignores_stays_ignored(tmp_path):
    ignoring = f"import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n{signal_at('fsync', signal.SIGHUP)}"
    assert call(["simulate", "gnss", "-o", str(tmp_path / "g")], ignoring).returncode == 0
    assert os.listdir(tmp_path) == ["g"]


@pytest.mark.parametrize("module", ["midspan.cli.process", "click", "midspan.cli.methods"])
def test_ctrl_c_during_the_imports_is_no_traceback(module):
    during = f"""
import os, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), {int(signal.SIGINT)})
sys.meta_path.insert(0, Finder())
"""
    done = call(["methods"], during)
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "midspan: interrupted; no partial files were left.\n"


def test_a_signal_that_a_library_turns_into_its_own_error_is_no_defect():
    raising = f"""
import os, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "midspan.cli.methods":
            try:
                os.kill(os.getpid(), {int(signal.SIGTERM)})
            except BaseException:
                raise ImportError("initialization failed") from None
sys.meta_path.insert(0, Finder())
"""
    done = call(["methods"], raising)
    assert done.returncode == 143
    assert done.stderr == "midspan: stopped by SIGTERM; no partial files were left.\n"


@pytest.mark.parametrize("arguments", [["formats", "--json"], ["--help"], ["nonsense", "--json"]])
def test_a_full_device_behind_standard_output_is_one_sentence(arguments):
    with open("/dev/full", "w") as full:
        done = call(arguments, stdout=full)
    assert done.returncode == 2
    assert done.stderr == f"midspan: standard output: {os.strerror(errno.ENOSPC)}.\n"


@pytest.mark.parametrize("arguments", [["formats", "--json"], ["--help"]])
def test_a_reader_who_has_left_ends_the_command_quietly(arguments):
    reading, writing = os.pipe()
    os.close(reading)
    done = call(arguments, stdout=writing)
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, "")


def test_the_result_is_whole_though_nobody_reads_the_words(gnss, tmp_path):
    with open("/dev/full", "w") as full:
        done = call(["calibrate", str(gnss), "-o", str(tmp_path / "c.json")], stdout=full)
    assert done.returncode == 2
    assert os.listdir(tmp_path) == ["c.json"]
    assert midspan.load_calibration(tmp_path / "c.json").displacement is not None


def test_errors_that_cannot_be_printed_keep_their_exit_code():
    with open("/dev/full", "w") as full:
        assert call(["nonsense"], stderr=full).returncode == 2
    assert call(["formats"], "import sys; sys.stdout = None").returncode == 0


# Drawing a word is where matplotlib asks for a place.
USE = """
import os
import midspan
from matplotlib.figure import Figure
Figure().savefig(os.devnull, format="png")
print(os.environ.get("MPLCONFIGDIR"))
"""
READ_ONLY = """
set -e
mount -t tmpfs none "$2"
mkdir "$2/home"
mount --bind "$1" "$1"
mount -o remount,bind,ro "$1"
mount -o remount,ro "$2"
exec "$3" -B -c "$4"
"""


def in_read_only_places(folder, program, **environment):
    """A program where neither the package nor the home can be written; only `folder`/tmp can."""
    private = ["unshare", "-m"] if os.geteuid() == 0 else ["unshare", "-rm"]
    if subprocess.run([*private, "mount", "-t", "tmpfs", "none", folder], capture_output=True, check=False).returncode:
        pytest.skip("this machine lets nobody mount a read-only folder")
    (folder / "home").mkdir()
    (folder / "tmp").mkdir(exist_ok=True)
    hidden = ("MPLCONFIGDIR", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "TEMP")
    own = {name: value for name, value in os.environ.items() if name not in hidden}
    places = {"HOME": str(folder / "home/home"), "TMPDIR": str(folder / "tmp"), "PYTHONPATH": str(SOURCES)}
    arguments = ["sh", "-c", READ_ONLY, "sh", str(SOURCES), str(folder / "home"), sys.executable, program]
    return subprocess.run(
        [*private, *arguments], env={**own, **places, **environment}, capture_output=True, text=True, check=False
    )


def test_a_read_only_package_and_home_are_served_from_a_folder_of_the_process(tmp_path):
    done = in_read_only_places(tmp_path, USE)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(str(tmp_path / "tmp" / "midspan-"))
    assert os.listdir(tmp_path / "tmp") == []


def test_without_any_place_what_draws_nothing_works(tmp_path):
    nowhere = "import os, tempfile\ntempfile._candidate_tempdir_list = lambda: ['/nowhere']\n"
    program = f"{nowhere}import midspan\nmidspan.smooth, midspan.open_tracker\nprint(os.environ.get('MPLCONFIGDIR'))"
    done = in_read_only_places(tmp_path, program, TMPDIR="")
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["None"]


def test_what_the_user_has_set_stays(tmp_path):
    (tmp_path / "tmp").mkdir()
    chosen = str(tmp_path / "tmp/m")
    assert in_read_only_places(tmp_path, USE, MPLCONFIGDIR=chosen).stdout.split() == [chosen]


def test_nothing_is_set_where_the_usual_places_can_be_written(tmp_path):
    own = {name: value for name, value in os.environ.items() if name != "MPLCONFIGDIR"}
    done = subprocess.run(
        [sys.executable, "-c", USE],
        env=own | {"HOME": str(tmp_path), "PYTHONPATH": str(SOURCES)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split() == ["None"]


def test_the_current_folder_is_not_replaced(tmp_path):
    done = call(["simulate", "gnss", "-o", "."], cwd=tmp_path)
    assert done.returncode == 2
    assert "is the current folder, or one above it" in done.stderr


def test_a_current_folder_that_is_gone_is_a_sentence(tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    done = call(
        ["inspect", "."], f"import os, sys; sys.path.insert(0, {str(SOURCES)!r}); os.rmdir(os.getcwd())", cwd=gone
    )
    assert done.returncode == 2
    assert "the current folder no longer exists" in done.stderr


def test_the_package_is_a_command(tmp_path):
    done = subprocess.run([sys.executable, "-m", "midspan", "formats"], cwd=tmp_path, capture_output=True, check=False)
    assert done.returncode == 0
    assert b"csv" in done.stdout.lower()


FLOODED = """
import asyncio, os, signal, threading, time
from midspan.cli.process import stop_by_signals

async def main():
    stopped, loop = asyncio.Event(), asyncio.get_running_loop()
    stop_by_signals(loop, stopped.set)
    def flood():
        for _ in range(20_000):
            loop.call_soon_threadsafe(lambda: None)
        os.kill(os.getpid(), signal.SIGTERM)
        filled.set()
    filled = threading.Event()
    threading.Thread(target=flood).start()
    filled.wait(60)
    await asyncio.wait_for(stopped.wait(), 10)

asyncio.run(main())
print("stopped")
"""


def test_a_signal_is_heard_by_a_loop_that_has_hundreds_of_messages_to_take():
    """The loop's own handler loses it: the socket that would wake the loop is full."""
    done = subprocess.run(
        [sys.executable, "-c", FLOODED], capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert (done.returncode, done.stdout) == (0, "stopped\n"), done.stderr
