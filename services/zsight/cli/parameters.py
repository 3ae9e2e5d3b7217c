"""``zsight param``: settings of running processes."""

from __future__ import annotations

import json as json_text
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zsight.cli.options import Connect, Json, Namespace, network_of
from zsight.cli.output import print_json, print_table, say

if TYPE_CHECKING:
    from zsight.client import CellClient
    from zsight_protocol.parameter import Parameter, ParameterAnswer

__all__ = ["app"]

app = typer.Typer(help="Settings of running processes.", no_args_is_help=True, rich_markup_mode=None)

Process = Annotated[str, typer.Argument(metavar="PROCESS", help="Name of a process, or HOST/NAME.")]
Name = Annotated[str, typer.Argument(metavar="SETTING", help="Name of a setting.")]


@app.command(name="list")
def list_parameters(
    process: Annotated[
        str, typer.Argument(metavar="[PROCESS]", help="Name of a process, or HOST/NAME; else all.")
    ] = "*",
    json: Json = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """All settings, their ranges, and whether they may change at run time."""
    with _cell(connect, namespace) as cell:
        answers = cell.parameters.list(process)
    if json:
        print_json({"processes": [_answer_json(answer) for answer in answers]})
        return
    rows = [
        (f"{a.host}/{a.process}", p.name, _text(p.value), _range(p), _when(p), p.description)
        for a in answers
        for p in a.parameters
    ]
    print_table(["process", "setting", "value", "range", "at run time", ""], rows)


@app.command()
def get(process: Process, name: Name, json: Json = False, connect: Connect = None, namespace: Namespace = None) -> None:
    """One setting as it is now."""
    with _cell(connect, namespace) as cell:
        found = cell.parameters.get(process, name)
    if json:
        print_json(found.model_dump(mode="json"))
    else:
        typer.echo(_text(found.value))


@app.command(name="set", context_settings={"ignore_unknown_options": True})
def set_parameter(
    process: Process,
    name: Name,
    value: Annotated[str, typer.Argument(metavar="VALUE", help="The new value; - for none.")],
    save: Annotated[bool, typer.Option("--save", help="Keep it over a restart of the process.")] = False,
    json: Json = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """Change a setting of a running process."""
    with _cell(connect, namespace) as cell:
        answer = cell.parameters.set(process, name, _value(cell, process, name, value), save=save)
    if json:
        print_json({**_answer_json(answer), "message": answer.message})
    else:
        say(f"{answer.host}/{answer.process}: {answer.message}")


def _value(cell: CellClient, process: str, name: str, typed: str) -> str | None:
    """What was typed; ``-`` and ``none`` are no value, as ``_text`` shows it."""
    if typed == "-" and cell.parameters.get(process, name).kind == "str":
        return ""
    return None if typed in ("-", "none") else typed


def _cell(connect: str | None, namespace: str | None) -> CellClient:
    from zsight.client import CellClient
    from zsight.runtime import join

    return CellClient(join(network_of(connect, namespace)))


def _answer_json(answer: ParameterAnswer) -> dict[str, Any]:
    return answer.model_dump(mode="json", exclude={"message"})


def _text(value: Any) -> str:
    """A value as it would be typed."""
    if value is None or value == "":
        return "-"
    return value if isinstance(value, str) else json_text.dumps(value)


def _range(parameter: Parameter) -> str:
    if parameter.choices:
        return " | ".join(map(_text, parameter.choices))
    if parameter.minimum is None and parameter.maximum is None:
        return parameter.kind
    low = "" if parameter.minimum is None else f"{parameter.minimum:g}"
    high = "" if parameter.maximum is None else f"{parameter.maximum:g}"
    return f"{'above ' if parameter.minimum_excluded else ''}{low} to {'below ' if parameter.maximum_excluded else ''}{high}"


def _when(parameter: Parameter) -> str:
    return f"{'yes' if parameter.live else 'needs a restart'}{', saved' if parameter.saved else ''}"
