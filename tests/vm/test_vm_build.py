"""The build, with tools made of shell: its order, its log, what a failing step says, and that the next try goes on."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from netlab.vm import build, cache, packages, recipe
from netlab.vm.request import BoxError

PROCESS_C = "ptrace(SET, pid, NULL, (void *) PTRACE_O_TRACESYSGOOD) < 0"

MAKE = """#!/bin/sh
echo "make $*" >>"$HOME/steps"
case "$*" in
*olddefconfig) cat "$HOME/fragment.config" >.config ;;
*linux)
  grep -q EXITKILL arch/um/os-Linux/skas/process.c || exit 1
  [ -e "$HOME/broken" ] && { echo "net/core/x.c:1: error: no"; exit 2; }
  echo "  CC      init/main.o"; echo kernel >linux ;;
esac
"""
SCRIPTS = {
    "make": MAKE,
    "strip": '#!/bin/sh\n[ "$1" = -o ] && cp "$3" "$2"\n',
    "tar": "#!/bin/sh\ntrue\n",
    "merge_config.sh": '#!/bin/sh\necho "merge $*" >>"$HOME/steps"\n',
}


@pytest.fixture
def tools(tmp_path: Path, store: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A PATH with our tools first, and a source package that needs no network."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name, text in SCRIPTS.items():
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")
    monkeypatch.setattr(build, "missing_tools", list)
    monkeypatch.setattr(packages, "candidate_version", lambda package: "6.1.9-1")
    monkeypatch.setattr(packages, "fetch", lambda package, target: unpack(target, folder))
    return store / "work" / "6.1.9-1"


def unpack(target: Path, tools: Path) -> None:
    tree = target / recipe.SOURCE_TREE
    for name in ("arch/um/os-Linux/skas", "scripts/kconfig"):
        (tree / name).mkdir(parents=True)
    (tree / recipe.PATCHES[0].path).write_text(PROCESS_C)
    (tree / "scripts/kconfig/merge_config.sh").symlink_to(tools / "merge_config.sh")


def test_a_build_ends_in_the_cache_and_leaves_its_log(tools: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[tuple[str, int]] = []
    built = build.build(lambda phase, _elapsed_s, percent: said.append((phase, percent)), jobs=3)
    assert built == cache.current_kernel()
    assert built.source_version == "6.1.9-1"
    assert built.path.read_text() == "kernel\n"
    assert (built.path.parent / cache.CONFIG).read_text() == cache.fragment()
    assert [phase for phase, _percent in said] == ["fetch", "unpack", "configure", "compile", "install"]
    assert [percent for _phase, percent in said] == sorted(percent for _phase, percent in said)
    assert not tools.exists()
    assert "CC      init/main.o" in (tools.parent / "build-6.1.9-1.log").read_text()

    def no_second(package: str) -> str:
        raise AssertionError

    monkeypatch.setattr(packages, "candidate_version", no_second)
    assert build.build(lambda *_: None, jobs=1) == built


def test_a_failed_step_names_its_log_and_the_next_try_goes_on(tools: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fetched = []
    fetch = packages.fetch
    monkeypatch.setattr(packages, "fetch", lambda *args: fetched.append(args) or fetch(*args))
    tools.mkdir(parents=True)

    def break_it(phase: str, _elapsed_s: float, _percent: int) -> None:
        if phase == "configure":
            (tools / "broken").touch()

    with pytest.raises(BoxError, match=r"make ARCH=um -j2 linux[^$]*build-6\.1\.9-1\.log[^$]*x\.c:1: error"):
        build.build(break_it, jobs=2)
    assert cache.current_kernel() is None
    (tools / "broken").unlink()
    assert build.build(lambda *_: None, jobs=2) == cache.current_kernel()
    assert len(fetched) == 1


def test_an_option_that_the_source_does_not_know_stops_the_build(tools: Path) -> None:
    def lose_one(phase: str, _elapsed_s: float, _percent: int) -> None:
        if phase == "configure":
            make = Path(os.environ["PATH"].split(":")[0], "make")
            make.write_text(MAKE.replace("cat ", "grep -v NET_SCH_NETEM "))

    with pytest.raises(BoxError, match=r"does not take these options: CONFIG_NET_SCH_NETEM=y$"):
        build.build(lose_one, jobs=1)


def test_all_missing_tools_are_named_at_once(tmp_path: Path) -> None:
    lacking = build.missing_tools(path=str(tmp_path), include=tmp_path)
    assert {"gcc", "make", "flex", "bison", "bc", "libelf-dev", "xz-utils"} <= set(lacking)
    with pytest.raises(BoxError, match=r"sudo apt-get install .*bc bison .*gcc .*libelf-dev make .*xz-utils"):
        build.check_tools(lacking)
    build.check_tools([])


def test_a_full_disk_is_told_before_the_build() -> None:
    with pytest.raises(BoxError, match=r"has 100 MiB free; building takes 3072 MiB"):
        build.check_room(100 << 20, Path("/w"))
