"""`netlab vm`: any command in a throw-away kernel, in real or virtual time; and the kernel itself."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import click

from netlab.vm import cache, recipe
from netlab.vm.build import build as build_kernel
from netlab.vm.build import missing_tools
from netlab.vm.fitness import ptrace_problem
from netlab.vm.request import BoxError, BoxRequest, Clock, KernelChoice, clean_environment, parse_memory
from netlab.vm.run import run_in_box
from netlab.vm.transfer import export_kernel, import_kernel

_COMMAND = "netlab.vm.command"


class _CommandAfterDashes(click.Group):
    """A group whose words after ``--`` are a command for the box, never a subcommand."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if "--" in args:
            at = args.index("--")
            ctx.meta[_COMMAND] = args[at + 1 :]
            args = args[:at]
        return super().parse_args(ctx, args)


def _memory(ctx: click.Context, param: click.Parameter, value: str) -> int:
    try:
        return parse_memory(value)
    except ValueError as error:
        raise click.BadParameter(str(error), ctx, param) from None


@click.group(cls=_CommandAfterDashes, invoke_without_command=True, options_metavar="[OPTIONS] -- COMMAND...")
@click.option("--kernel", type=click.Choice([choice.value for choice in KernelChoice]), default="auto")
@click.option("--clock", type=click.Choice([clock.value for clock in Clock]), default="real", show_default=True)
@click.option("--memory", callback=_memory, default="2G", show_default=True, help="Of the guest, as 512M or 2G.")
@click.option("--timeout", "timeout_s", type=click.FloatRange(min=0, min_open=True), default=600.0, show_default=True)
@click.option("--output", type=click.Path(path_type=Path), help="The one folder whose content outlives the box.")
@click.option("--env", "extra", multiple=True, metavar="NAME[=VALUE]", help="Give the command this variable too.")
@click.option("-v", "--verbose", is_flag=True, help="Say which kernel ran, and how long by each clock.")
@click.pass_context
def vm(
    ctx: click.Context,
    kernel: str,
    clock: str,
    memory: int,
    timeout_s: float,
    output: Path | None,
    extra: tuple[str, ...],
    verbose: bool,
) -> None:
    """Run COMMAND in a throw-away kernel over this machine's files, or look after that kernel.

    The command sees the host's files read-only; what it writes is lost, except below --output. It runs as root of the
    box with the caller's rights outside. --timeout counts seconds of the host's clock. Exit code: the command's; 124
    when the time limit ended it; 2 when the box cannot start.
    """
    command: list[str] = ctx.meta.get(_COMMAND, [])
    if ctx.invoked_subcommand is not None:
        return
    if not command:
        raise click.UsageError("name a command after --, as in: netlab vm --clock virtual -- make test", ctx)
    request = BoxRequest(
        argv=tuple(command),
        cwd=Path.cwd(),
        env=clean_environment(dict(os.environ), extra=_extra(extra)),
        output=None if output is None else output.absolute(),
        kernel=KernelChoice(kernel),
        clock=Clock(clock),
        memory_bytes=memory,
        timeout_s=timeout_s,
    )
    result = run_in_box(request)
    for note in result.notes:
        click.echo(f"netlab vm: {note}", err=True)
    if result.timed_out:
        click.echo(f"netlab vm: ended by the time limit of {timeout_s:g} s on the host's clock (--timeout)", err=True)
    if verbose:
        inside = "" if result.guest_s is None else f", {result.guest_s:.1f} s by the clock inside"
        click.echo(
            f"netlab vm: {result.kernel}: up in {result.boot_s:.1f} s, {result.wall_s:.1f} s in all{inside}", err=True
        )
    ctx.exit(result.exit_code)


def _extra(words: tuple[str, ...]) -> dict[str, str]:
    found = {}
    for word in words:
        name, equals, value = word.partition("=")
        if not name or (not equals and name not in os.environ):
            raise click.BadParameter(
                f"{word!r}: write NAME=VALUE, or the NAME of a variable that is set", param_hint="--env"
            )
        found[name] = value if equals else os.environ[name]
    return found


@vm.command()
@click.option("-j", "--jobs", type=click.IntRange(min=1), default=os.cpu_count() or 1, show_default=True)
@click.option("--force", is_flag=True, help="Build although the cache has this kernel.")
def build(jobs: int, force: bool) -> None:
    """Build the kernel with virtual time, once: about 10 minutes on two cores."""
    known = cache.current_kernel()
    if known is not None and not force:
        click.echo(f"already built: {known.path} (from {recipe.SOURCE_PACKAGE} {known.source_version})")
        return
    click.echo(f"building from {recipe.SOURCE_PACKAGE}; about 10 minutes on two cores, at low priority", err=True)
    kernel = build_kernel(_report, jobs=jobs, force=force)
    click.echo(f"built: {kernel.path}")


def _report(phase: str, elapsed_s: float, percent: int) -> None:
    click.echo(f"[{elapsed_s:4.0f} s] {percent:3d} % {phase}", err=True)


@vm.command()
@click.argument("file", type=click.Path(path_type=Path))
def export(file: Path) -> None:
    """Write the built kernel to FILE, for another machine or a cache of CI."""
    kernel = export_kernel(file)
    click.echo(f"{file}: kernel {kernel.key} (from {recipe.SOURCE_PACKAGE} {kernel.source_version})")


@vm.command("import")
@click.argument("file", type=click.Path(path_type=Path))
def import_(file: Path) -> None:
    """Take the kernel in FILE, after checking its hash and booting it."""
    kernel = import_kernel(file)
    click.echo(f"imported: {kernel.path}")


@vm.command()
@click.pass_context
def status(ctx: click.Context) -> None:
    """Say which kernels are there. Exit code: 0 if virtual time works, 1 if not yet."""
    current = cache.current_kernel()
    for kernel in cache.built_kernels():
        state = "current" if kernel.current else "of another configuration"
        click.echo(f"uml     {kernel.key} from {recipe.SOURCE_PACKAGE} {kernel.source_version}, {state}: {kernel.path}")
    if current is None:
        lacking = missing_tools()
        tools = f"; first: sudo apt-get install {' '.join(lacking)}" if lacking else ""
        click.echo(f"uml     not built: no virtual time; `netlab vm build` takes about 10 minutes, once{tools}")
    for folder in sorted((cache.root() / "packages").glob("*/")):
        click.echo(f"package {folder.name}")
    refused = ptrace_problem()
    click.echo(f"ptrace  {'works' if not refused else os.strerror(refused)}")
    ctx.exit(0 if current is not None and not refused else 1)


def main() -> None:
    """`python -m netlab.cli.vm`."""
    try:
        sys.exit(vm.main(prog_name="netlab vm", standalone_mode=False) or 0)
    except click.ClickException as error:
        error.show()
        sys.exit(2)
    except BoxError as error:
        click.echo(f"netlab vm: {error}", err=True)
        sys.exit(2)


if __name__ == "__main__":
    main()
