"""The recipe of the kernel, its key, and the parts that a stock kernel needs."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.vm import cache, initramfs, modules, qemu, recipe, uml
from netlab.vm.initramfs import Entry
from netlab.vm.kernels import Emulator, Kernel
from netlab.vm.recipe import Patch, Progress
from netlab.vm.request import Clock


def test_the_key_depends_on_what_the_fragment_says_not_on_how() -> None:
    key = recipe.key("6.1-1", "CONFIG_A=y\n# CONFIG_B is not set\n")
    assert recipe.key("6.1-1", "# why\n# CONFIG_B is not set\n\nCONFIG_A=y\n") == key
    assert recipe.key("6.1-1", "CONFIG_A=m\n# CONFIG_B is not set\n") != key
    assert recipe.key("6.1-2", "CONFIG_A=y\n# CONFIG_B is not set\n") != key
    assert recipe.key("6.1-1", "CONFIG_A=y\n# CONFIG_B is not set\n", recipe=99) != key


def test_options_that_the_source_does_not_take_are_named() -> None:
    final = "CONFIG_A=y\nCONFIG_B=m\n# CONFIG_C is not set\n"
    wanted = "CONFIG_A=y\nCONFIG_B=y\nCONFIG_D=y\n# CONFIG_C is not set\n# CONFIG_E is not set\n# CONFIG_A is not set\n"
    assert recipe.lost_options(wanted.replace("# CONFIG_A is not set\n", ""), final) == ["CONFIG_B=y", "CONFIG_D=y"]
    assert recipe.lost_options("# CONFIG_A is not set\n", final) == ["# CONFIG_A is not set"]


def test_the_fragment_has_what_the_engines_need() -> None:
    have = recipe.options(cache.fragment())
    for name in (
        "UML_TIME_TRAVEL_SUPPORT",
        "NET_SCH_NETEM",
        "NET_ACT_MIRRED",
        "VETH",
        "HOSTFS",
        "OVERLAY_FS",
        "USER_NS",
    ):
        assert have[f"CONFIG_{name}"] == f"CONFIG_{name}=y"


def test_a_patch_applies_once_and_tells_when_the_source_has_changed() -> None:
    patch = Patch("a.c", r"old\(\)", "new()")
    once = recipe.apply_patch(patch, "x = old();")
    assert once == "x = new();"
    assert recipe.apply_patch(patch, once) == once
    with pytest.raises(ValueError, match=r"a\.c.*mend the recipe"):
        recipe.apply_patch(patch, "x = other();")


@pytest.mark.parametrize("call", ["(void *) PTRACE_O_TRACESYSGOOD)", "(void *)PTRACE_O_TRACESYSGOOD)"])
def test_guest_processes_are_made_to_die_with_their_tracer(call: str) -> None:
    (patch,) = recipe.PATCHES
    assert "PTRACE_O_EXITKILL" in recipe.apply_patch(patch, f"ptrace(x, pid, NULL, {call} < 0")


@given(st.lists(st.sampled_from(["  CC      a.o\n", "  LD      b\n", "make: nothing\n", "  CALL x\n"]), max_size=40))
def test_progress_never_falls_back_and_is_never_done_early(lines: list[str]) -> None:
    progress, before = Progress(steps=10), 0
    for line in lines:
        progress.line(line)
        assert before <= progress.percent <= 99
        before = progress.percent
    assert before == min(99, 10 * sum(line.startswith(("  CC", "  LD")) for line in lines))


def module(depends: str) -> bytes:
    return b"\x7fELF rubbish\0license=GPL\0depends=" + depends.encode() + b"\0name=x\0"


def test_modules_come_after_what_they_need_with_their_options(tmp_path: Path) -> None:
    for name, needs in (("sch_netem", ""), ("ifb", "core-a,core_b"), ("core-a", "core_b"), ("core_b", "")):
        (tmp_path / f"{name}.ko").write_bytes(module(needs))
    order = [
        (Path(path).name, options) for path, options in modules.load_order(tmp_path, ["ifb", "missing", "sch-netem"])
    ]
    assert order == [("core_b.ko", ""), ("core-a.ko", ""), ("ifb.ko", "numifbs=0"), ("sch_netem.ko", "")]
    assert modules.load_order(None, ["ifb"]) == []


@given(st.binary(max_size=300))
def test_any_bytes_have_some_dependencies_or_are_refused(data: bytes) -> None:
    assert isinstance(modules.depends(data + b"\0"), list)


names = st.text(st.characters(min_codepoint=97, max_codepoint=122), min_size=1, max_size=9)


@given(st.lists(st.builds(Entry, names, st.just(0o100644), st.binary(max_size=50)), max_size=5))
def test_an_archive_holds_what_was_put_in(entries: list[Entry]) -> None:
    assert [(entry.name, entry.mode, entry.data) for entry in unpack(initramfs.cpio(entries))] == [
        (entry.name, entry.mode, entry.data) for entry in entries
    ]


def unpack(archive: bytes) -> list[Entry]:
    """A reader of cpio(5)'s newc format, written from that page."""
    found, at = [], 0
    while True:
        assert archive[at : at + 6] == b"070701"
        fields = [int(archive[at + 6 + 8 * i : at + 14 + 8 * i], 16) for i in range(13)]
        mode, size, name_size = fields[1], fields[6], fields[11]
        name = archive[at + 110 : at + 110 + name_size - 1].decode()
        data = (at + 110 + name_size + 3) & ~3
        if name == "TRAILER!!!":
            return found
        found.append(Entry(name, mode, archive[data : data + size]))
        at = (data + size + 3) & ~3


def test_the_ramdisk_loads_in_order_and_hands_over_to_the_boxs_init() -> None:
    archive = unpack(initramfs.build(b"BUSYBOX", {"b.ko": b"2", "a.ko": b"1"}, ["/x/python", "/x/init.py"]))
    files = {entry.name: entry for entry in archive}
    assert files["modules/b.ko"].data == b"2"
    assert files["init"].mode & 0o111
    text = files["init"].data.decode()
    assert "for module in b.ko a.ko;" in text
    assert "switch_root -c /dev/console /root /x/python /x/init.py" in text


def test_the_root_is_read_only_under_qemu_and_commas_in_paths_are_doubled() -> None:
    options = qemu.share_options({"root": Path("/"), "output": Path("/a,b")})
    assert "path=/,security_model=none,readonly=on" in options[1]
    assert "path=/a,,b,security_model=none,readonly=off" in options[5]


def test_virtual_time_is_asked_for_only_when_wanted() -> None:
    def line(clock: Clock) -> list[str]:
        return uml.command_line(Path("/k"), Path("/c"), memory_bytes=1 << 30, clock=clock, start_ns=5)

    assert {"time-travel=inf-cpu", "time-travel-start=5"} <= set(line(Clock.VIRTUAL))
    assert not any("time-travel" in word for word in line(Clock.REAL))
    for words in (line(Clock.REAL), line(Clock.VIRTUAL)):
        assert words[0] == "/k"
        assert "ro" in words  # else the guest writes the host's files
        assert "rw" not in words
        assert "mem=1024M" in words
        assert words[words.index("--") + 1 :] == ["-I", "-S", "-B", "/c/init.py", "/c"]


def test_kvm_that_does_not_answer_is_done_without_and_remembered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    probes = []
    monkeypatch.setattr(qemu, "KVM", tmp_path)
    monkeypatch.setattr(qemu, "_probe", lambda argv: probes.append(argv) or False)
    kernel = Kernel(Emulator.QEMU, Path("/vmlinuz"), "linux-image-x")
    for _ in range(2):
        assert not qemu.kvm_boots(kernel, Path("/initrd"), memory=tmp_path / "memo")
    assert len(probes) == 1
    assert initramfs.PROBE_WORD in probes[0][probes[0].index("-append") + 1]
