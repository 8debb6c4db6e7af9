"""Carries a built kernel from one machine to another as one file, checked and tried before it enters the cache."""

from __future__ import annotations

import io
import json
import tarfile
from pathlib import Path

from netlab.vm import cache, recipe
from netlab.vm.cache import CONFIG, KERNEL, METADATA, BuiltKernel
from netlab.vm.kernels import Emulator, Kernel
from netlab.vm.request import BoxError, BoxRequest, Clock, clean_environment
from netlab.vm.run import Streams, run_in_box

_MEMBERS = (METADATA, CONFIG, KERNEL)
_MAX_MEMBER_BYTES = 256 << 20
_TRIAL_LIMIT_S = 60.0
_TRIAL_MEMORY_BYTES = 256 << 20


def export_kernel(target: Path) -> BuiltKernel:
    """Write the current kernel to ``target``, a compressed tar.

    Raises:
        BoxError: None is built, or the file cannot be written.
    """
    kernel = cache.current_kernel()
    if kernel is None:
        raise BoxError("no kernel of this configuration is built; run `netlab vm build` first")
    try:
        with tarfile.open(target, "w:gz") as archive:
            for name in _MEMBERS:
                archive.add(kernel.path.parent / name, name, filter=_anonymous)
    except OSError as error:
        raise BoxError(f"{target}: {error.strerror}") from error
    return kernel


def import_kernel(source: Path) -> BuiltKernel:
    """Enter the kernel in ``source`` into the cache, once its hash is right and it has booted here.

    Raises:
        BoxError: No such file, no kernel, a wrong hash, a key that does not fit, or it does not boot.
    """
    members = _read(source)
    store = cache.root() / "uml"
    with cache.locked("import"), cache.entering(store / _key(members[METADATA], source)) as folder:
        for name, data in members.items():
            (folder / name).write_bytes(data)
        (folder / KERNEL).chmod(0o755)
        kernel = cache.read_kernel(folder)
        _check(kernel, source)
        assert kernel is not None
        _try(kernel, source)
    entered = cache.read_kernel(store / kernel.key)
    assert entered is not None
    return entered


def _key(metadata: bytes, source: Path) -> str:
    """The key that this checkout gives to that source; never a name out of the file."""
    try:
        return recipe.key(str(json.loads(metadata)["source_version"]), cache.fragment())
    except (ValueError, KeyError, TypeError) as error:
        raise BoxError(f"{source}: its {METADATA} cannot be read") from error


def _anonymous(member: tarfile.TarInfo) -> tarfile.TarInfo:
    member.uid = member.gid = 0
    member.uname = member.gname = ""
    return member


def _read(source: Path) -> dict[str, bytes]:
    """The three members; nothing else is looked at, and no path of the archive is used."""
    found: dict[str, bytes] = {}
    try:
        with tarfile.open(source, "r:gz") as archive:
            for member in archive:
                if member.name in _MEMBERS and member.isfile() and member.size <= _MAX_MEMBER_BYTES:
                    found[member.name] = (archive.extractfile(member) or io.BytesIO()).read()
    except FileNotFoundError:
        raise BoxError(f"{source}: no such file") from None
    except (OSError, tarfile.TarError, EOFError) as error:
        raise BoxError(f"{source}: not a file that `netlab vm export` wrote ({error})") from error
    lacking = [name for name in _MEMBERS if name not in found]
    if lacking:
        raise BoxError(f"{source}: has no {', '.join(lacking)}; it is no file that `netlab vm export` wrote")
    return found


def _check(kernel: BuiltKernel | None, source: Path) -> None:
    if kernel is None:
        raise BoxError(f"{source}: its {METADATA} cannot be read")
    if cache.file_hash(kernel.path) != kernel.sha256:
        raise BoxError(
            f"{source}: the kernel's hash is not the one noted with it; the file is damaged, export it again"
        )
    wanted = recipe.key(kernel.source_version, cache.fragment())
    if kernel.key != wanted or not kernel.current:
        raise BoxError(
            f"{source}: this kernel ({kernel.key}) is of another configuration than this checkout's ({wanted}); "
            "export one from the same version of the project, or run `netlab vm build`"
        )


def _try(kernel: BuiltKernel, source: Path) -> None:
    """Boot it in virtual time and let it say a word."""
    request = BoxRequest(
        argv=("echo", kernel.key),
        cwd=Path("/"),
        env=clean_environment({}),
        clock=Clock.VIRTUAL,
        memory_bytes=_TRIAL_MEMORY_BYTES,
        timeout_s=_TRIAL_LIMIT_S,
    )
    out, err = io.BytesIO(), io.BytesIO()
    try:
        result = run_in_box(request, Streams(out, err), kernel=Kernel(Emulator.UML, kernel.path, f"import of {source}"))
    except BoxError as error:
        raise BoxError(f"{source}: the kernel does not boot here: {error}") from error
    if result.exit_code or out.getvalue().strip() != kernel.key.encode():
        raise BoxError(f"{source}: the kernel boots, but a command in it fails (exit code {result.exit_code})")
