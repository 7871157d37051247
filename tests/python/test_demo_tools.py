# SPDX-License-Identifier: BSD-3-Clause
"""tools/demo looks at the machine first, says in one line what is missing, and then how far its build is.

Compilers, packages, memory and disks are made up: programs of a test's own on PATH, and functions that the
scripts call. Nothing is built or installed.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
pty = pytest.importorskip("pty")

if shutil.which("bash") is None:
    pytest.skip("no bash here", allow_module_level=True)

#: What the scripts call, beside what a test makes up.
NEEDED = "awk bash basename cat df dirname env grep head mkdir nproc rm sed sleep tail tr uname"


class Machine:
    """A folder of programs that is all of PATH, and a copy of the scripts, which write beside themselves."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.root = folder / "ndtree"
        self.programs = folder / "bin"
        self.programs.mkdir(parents=True)
        for name in NEEDED.split():
            (self.programs / name).symlink_to(shutil.which(name) or pytest.skip(f"no {name} here"))
        (self.root / "tools").mkdir(parents=True)
        for name in ("demo", "setup", "machine"):
            shutil.copy(ROOT / "tools" / name, self.root / "tools" / name)
        shutil.copy(ROOT / "pyproject.toml", self.root)
        self.has("c++", "exit 0")

    def has(self, name: str, script: str) -> None:
        """A program; what it is called with is in the file "calls"."""
        path = self.programs / name
        path.unlink(missing_ok=True)
        path.write_text(f'#!/bin/bash\necho "{name} $*" >>"{self.folder}/calls"\n{script}\n')
        path.chmod(0o755)

    def lacks(self, *names: str) -> None:
        for name in names:
            (self.programs / name).unlink(missing_ok=True)

    @property
    def calls(self) -> list[str]:
        path = self.folder / "calls"
        return path.read_text().splitlines() if path.exists() else []

    def run(self, code: str, **env: str) -> subprocess.CompletedProcess[str]:
        """Shell code, after the scripts' functions."""
        begin = f'cd "{self.root}"; source tools/setup; source tools/machine\n'
        return self.call("bash", "-c", begin + code, **env)

    def call(self, *command: str | Path, **env: str) -> subprocess.CompletedProcess[str]:
        given = {"PATH": str(self.programs), "HOME": str(self.folder), **env}
        return subprocess.run(command, capture_output=True, text=True, check=False, env=given)


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def refused(done: subprocess.CompletedProcess[str], *expected: str) -> None:
    """One line says what is wrong, and the script ends."""
    assert done.returncode == 1, done.stdout + done.stderr
    assert done.stderr.count("\n") == 1, done.stderr
    for text in expected:
        assert text in done.stderr


# --- What is looked at first ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("memory", "swap", "cores", "jobs", "said"),
    [
        (16000, 0, 4, 4, ""),
        (4400, 0, 4, 4, ""),
        (4399, 0, 4, 3, "Compiling with 3 of 4 cores: 4.3 GB of memory are free"),
        (1900, 0, 2, 1, "Compiling with 1 of 2 cores: 1.9 GB of memory are free"),
        (700, 2048, 2, 1, "Compiling with 1 of 2 cores: 0.7 GB of memory are free"),
        ("", "", 8, 8, ""),  # A system that does not say.
    ],
)
def test_as_many_compilers_run_as_the_memory_is_for(
    machine: Machine, memory: object, swap: object, cores: int, jobs: int, said: str
) -> None:
    machine.has("nproc", f"echo {cores}")
    known = f"available_memory() {{ echo {memory}; }}; free_swap() {{ echo {swap}; }}\n"
    done = machine.run(known + 'check_memory; echo "jobs $CMAKE_BUILD_PARALLEL_LEVEL"')
    assert done.returncode == 0, done.stderr
    *lines, last = done.stdout.splitlines()
    assert last == f"jobs {jobs}"
    assert len(lines) == bool(said) and "".join(lines).startswith(said)
    # A number that the user chose stays.
    done = machine.run(
        known + "check_memory; echo $CMAKE_BUILD_PARALLEL_LEVEL", CMAKE_BUILD_PARALLEL_LEVEL="7"
    )
    assert done.stdout == "7\n"


def test_less_memory_than_one_compiler_needs_is_refused(machine: Machine) -> None:
    done = machine.run("available_memory() { echo 600; }; free_swap() { echo 100; }; check_memory")
    refused(done, "0.6 GB of memory are free", "needs up to 1.1 GB", "add swap")


@pytest.mark.parametrize(("there", "free", "needed"), [(False, 1400, "1.5 GB"), (True, 200, "0.3 GB")])
def test_too_little_disk_is_refused(machine: Machine, there: bool, free: int, needed: str) -> None:
    machine.has("df", f'echo "Filesystem 1M Used Available"; echo "/dev/x 9 9 {free} 1% /"')
    if there:
        (machine.root / ".venv/bin").mkdir(parents=True)
        (machine.root / "build").mkdir()
        (machine.root / ".venv/bin/ndtree").write_text("")
        (machine.root / ".venv/bin/ndtree").chmod(0o755)
    refused(machine.run("check_disk"), str(machine.root), f"{free / 1024:.1f} GB of disk are free", needed)
    machine.has("df", f'echo "Filesystem 1M Used Available"; echo "/dev/x 9 9 {free + 110} 1% /"')
    assert machine.run("check_disk").returncode == 0


def test_a_compiler_that_is_missing_or_too_old_is_refused(machine: Machine) -> None:
    machine.has("c++", "[[ $* == --version ]] && echo 'c++ (Debian 4.9) 4.9.2' && exit 0; exit 1")
    refused(machine.run("check_compiler"), "c++ (Debian 4.9) 4.9.2) does not compile C++17", "GCC 9")
    refused(machine.run("check_compiler", CXX="g++-99"), 'no C++ compiler "g++-99"', "named in CXX")
    machine.lacks("c++")
    refused(
        machine.run("check_compiler"), "no C++ compiler: expected GCC 9", "apt-get install build-essential"
    )
    # Where tools/setup will install one, nothing is said.
    machine.has("dpkg-query", "exit 1")
    machine.has("sudo", 'exec "$@"')
    done = machine.run("check_compiler")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize(
    ("system", "known"),
    [
        ('ID=debian\nVERSION_ID="12"', True),
        ('ID=debian\nVERSION_ID="13"', True),
        ('ID=ubuntu\nVERSION_ID="22.04"', True),
        ('ID=ubuntu\nVERSION_ID="24.04"', True),
        ('ID=fedora\nVERSION_ID=41\nPRETTY_NAME="Fedora Linux 41"', False),
        ('ID=debian\nPRETTY_NAME="Debian GNU/Linux trixie/sid"', False),
    ],
)
def test_other_systems_are_named(machine: Machine, system: str, known: bool) -> None:
    release = machine.folder / "os-release"
    release.write_text(system)
    done = machine.run("check_system", OS_RELEASE=str(release))
    assert done.returncode == 0
    if known:
        assert done.stdout == ""
    else:
        name = re.search('PRETTY_NAME="(.*)"', system)[1]
        assert done.stdout.startswith(f"{name} is none of the systems") and done.stdout.count("\n") == 1


# --- Packages ---------------------------------------------------------------------------------------


@pytest.fixture
def debian(machine: Machine) -> Machine:
    """A system with apt, whose installed packages, and those of its release, are lists in files."""
    machine.has("sudo", 'exec "$@"')
    machine.has("python3", "exit 0")
    installed, known = machine.folder / "installed", machine.folder / "known"
    installed.touch()
    known.write_text("build-essential\n")
    machine.has("dpkg-query", f'grep -qx "${{@: -1}}" "{installed}" && printf "install ok installed"')
    # As apt-cache writes it, with more lines than a pipe holds.
    machine.has(
        "apt-cache",
        f'grep -qx "$2" "{known}" && found=1\necho "$2:"; echo "  Installed: (none)"\n'
        'echo "  Candidate: ${found:-(none)}"\n'
        'for ((i = 0; i < 3000; i++)); do echo "  Version table $i of what is known"; done',
    )
    machine.has(
        "apt-get",
        f'for word; do grep -qx -- "$word" "{known}" && echo "$word" >>"{installed}"; done\n'
        f"[[ $* != *install* || $* != *missing-one* ]]",
    )
    return machine


PACKAGES = "apt_build=(build-essential cmake) apt_optional=(liboctomap-dev) apt_optional_test=(chromium)\n"


def test_packages_that_a_release_lacks_are_passed_over_if_they_are_optional(debian: Machine) -> None:
    (debian.folder / "known").write_text("build-essential\ncmake\nliboctomap-dev\nlibgtest-dev\n")
    done = debian.run(PACKAGES + "apt_optional_docs=(); setup_system test")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "This release has no package chromium: going on without\n" in done.stdout
    (install,) = (call for call in debian.calls if call.startswith("apt-get") and " install " in call)
    assert install.split("--no-install-recommends ")[1].split() == [
        "build-essential", "cmake", "libgtest-dev", "liboctomap-dev"
    ]  # fmt: skip
    # The next time nothing is fetched for it.
    (debian.folder / "calls").unlink()
    done = debian.run(PACKAGES + "apt_optional_docs=(); setup_system test")
    assert done.returncode == 0 and "no package chromium: going on without" in done.stdout
    assert not [call for call in debian.calls if call.startswith("apt-get")]


def test_packages_that_a_release_lacks_are_named_if_they_are_needed(debian: Machine) -> None:
    done = debian.run(PACKAGES + "setup_system demo")
    refused(done, "this release has no package cmake, which is needed")


# --- All of it --------------------------------------------------------------------------------------


def python_for_all() -> str:
    """An interpreter that other users can read, too, if there is one."""
    return shutil.which("python3", path="/usr/bin:/usr/local/bin") or os.path.realpath(sys.executable)


@pytest.fixture
def built(request: pytest.FixtureRequest) -> Iterator[Machine]:
    """A machine with all packages, where pip and CMake only pretend to build; others may read it."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    machine = Machine(folder)
    machine.has("dpkg-query", 'printf "install ok installed"')
    machine.has("cmake", "exit 0")
    bin_folder = machine.root / ".venv/bin"
    bin_folder.mkdir(parents=True)
    python = bin_folder / "python"
    lines = "".join(
        f"  [{i}/8] Building CXX object map_{i}.cpp.o\\n" for i in range(1, 9)
    )  # As pip, with -v.
    real_python = python_for_all()
    python.write_text(
        '#!/bin/bash\nif [[ "$1 $2" == "-m pip" ]]; then\n'
        f'  [[ $* == *build-dir* ]] && printf %b "{lines}" && sleep 1.5\n'
        f'  exit 0\nfi\nexec "{real_python}" "$@"\n'
    )
    (bin_folder / "ndtree").write_text('#!/bin/bash\necho "ndtree $*"\n')
    machine.has("python3", f'exec "{real_python}" "$@"')
    for path in (python, bin_folder / "ndtree"):
        path.chmod(0o755)
    for path in [machine.root, *machine.root.rglob("*")]:
        path.chmod(0o777 if path.is_dir() else 0o755)
    machine.folder.joinpath("calls").touch()
    machine.folder.joinpath("calls").chmod(0o666)
    yield machine
    shutil.rmtree(folder)


@pytest.mark.parametrize("root", [True, False])
def test_the_demo_sets_up_builds_and_calls_ndtree(built: Machine, root: bool) -> None:
    as_user: list[str] = []
    if not root:
        if os.geteuid() != 0 or shutil.which("setpriv") is None:
            pytest.skip("cannot become another user here")
        as_user = [shutil.which("setpriv") or "", "--reuid=65534", "--regid=65534", "--clear-groups"]
        for path in (python_for_all(), built.root):
            if subprocess.run([*as_user, "test", "-r", path], check=False).returncode:
                pytest.skip(f"others cannot read {path}")
    done = built.call(*as_user, "bash", built.root / "tools/demo", "a log.bag", "--every", "2")
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    assert next(line for line in lines if line.startswith("==")) == "== Set up"
    assert "Debian packages: all there" in lines and "Python packages: all there" in lines
    assert lines[-1] == "ndtree demo a log.bag --every 2"
    assert sum(bool(re.fullmatch(r"ok, \d+ s", line)) for line in lines) >= 1


def test_a_compiler_that_was_killed_is_explained(built: Machine) -> None:
    python = built.root / ".venv/bin/python"
    killed = "c++: fatal error: Killed signal terminated program cc1plus"
    python.write_text(python.read_text().replace("sleep 1.5", f'echo "  {killed}" && exit 1'))
    done = built.call("bash", built.root / "tools/demo")
    assert done.returncode == 1
    assert killed in done.stdout and "FAILED after" in done.stdout
    assert done.stdout.splitlines()[-1] == (
        "The system ended a compiler, most likely for lack of memory; one at a time needs least: "
        "CMAKE_BUILD_PARALLEL_LEVEL=1 tools/demo"
    )


def test_the_demo_stops_before_it_installs_anything(built: Machine) -> None:
    built.has("c++", "exit 1")
    done = built.call("bash", built.root / "tools/demo")
    refused(done, "demo: c++", "does not compile C++17")
    assert done.stdout == "\n== Set up\n"
