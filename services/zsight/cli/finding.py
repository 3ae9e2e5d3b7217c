"""``zsight find``: ask a finder, or look into a file without a network."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zsight.cli.options import CameraPose, Connect, Intrinsics, Json, Namespace, Picture, network_of, refuse_options
from zsight.cli.output import print_json, say
from zsight.errors import DeadlinePassed, UsageError
from zsight.words import numbers

if TYPE_CHECKING:
    from zsight.merging import MergedAnswer, MergedObject
    from zsight_protocol.find_object import DetectedObject, FindObjectResult, Obstacle
    from zsight_protocol.geometry import Region

__all__ = ["describe", "find", "result_json"]


def find(
    context: typer.Context,
    object_type: Annotated[
        str,
        typer.Argument(
            metavar="TYPE", help="Catalogue name or the book's number, such as toy_block or 1000; any for all types."
        ),
    ],
    json: Json = False,
    frame: Annotated[str, typer.Option("--frame", help="Frame of the answer; the world's if not given.")] = "",
    timeout: Annotated[float, typer.Option("--timeout", min=0.01, max=3600, help="Seconds.")] = 10.0,
    every: Annotated[bool, typer.Option("--all", help="All instances, not only the most probable one.")] = False,
    known_height: Annotated[
        float | None,
        typer.Option("--known-height", metavar="H", help="Height of the support surface in the frame, metres."),
    ] = None,
    region: Annotated[
        str | None,
        typer.Option("--region", metavar='"X0 Y0 Z0 X1 Y1 Z1"', help="Only what lies in this box of the frame."),
    ] = None,
    new: Annotated[bool, typer.Option("--new", help="Wait for a cloud measured after the question.")] = False,
    finder: Annotated[
        str, typer.Option("--finder", help="Which finder is asked; 'all' of them; the best match if not given.")
    ] = "any",
    cloud: Annotated[
        Path | None,
        typer.Option(
            "--cloud", metavar="FILE", help="Look into this file (.pcd, .ply, ..-depth.png) instead; no network."
        ),
    ] = None,
    camera_pose: CameraPose = "",
    intrinsics: Intrinsics = None,
    catalogue: Annotated[
        Path | None,
        typer.Option("--catalogue", metavar="FOLDER", help="With --cloud: further object types (YAML files)."),
    ] = None,
    picture: Picture = None,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """Find an object; exit code 0 found, 1 not found or cannot tell, 3 nobody answers, 4 too late, 5 cancelled."""
    box = _region(region)
    if cloud is not None:
        refuse_options(context, _ONLINE, "means nothing with --cloud")
    else:
        refuse_options(context, _OFFLINE, "needs --cloud FILE")
    if cloud is not None:
        from zsight.cli.running import require_warm
        from zsight.offline import find_in_file

        require_warm()  # or the time allowed would be over before the search begins
        result = find_in_file(
            cloud, object_type, intrinsics=intrinsics, pose=camera_pose, catalogue=catalogue, known_height=known_height, region=box,
            maximum=0 if every else 1, timeout=timeout, picture=picture,
        )  # fmt: skip
    elif finder == EVERY_FINDER:
        from zsight.cli.asking import ask_all

        refuse_options(context, ("picture",), "means nothing with --finder all")
        answer = ask_all(
            network_of(connect, namespace), object_type, frame=frame, timeout=timeout, known_height=known_height,
            region=box, new=new, maximum=0 if every else 1,
        )  # fmt: skip
        if json:
            print_json(merged_json(answer))
        else:
            say(describe_merged(answer))
        raise typer.Exit(0 if answer else 1)
    else:
        from zsight.cli.asking import ask

        try:
            result = ask(
                network_of(connect, namespace), object_type, finder=finder, frame=frame, timeout=timeout,
                known_height=known_height, region=box, new=new, maximum=0 if every else 1, picture=picture, quiet=json,
            )  # fmt: skip
        except DeadlinePassed as late:
            if json and late.known is not None:
                print_json(result_json(late.known))
            raise
    if json:
        print_json(result_json(result))
    else:
        say(describe(result))
        report: dict[str, Any] = dict(result.report)
        for warning in report.get("warnings", []):
            say(f"warning: {warning}")
        if words := _way(result):
            say(words)
    raise typer.Exit(0 if result.objects else 1)


EVERY_FINDER = "all"
_ONLINE = ("frame", "new", "finder", "connect", "namespace")
_OFFLINE = ("camera_pose", "intrinsics", "catalogue")


def _region(text: str | None) -> Region | None:
    if text is None:
        return None
    from pydantic import ValidationError

    from zsight_protocol.geometry import Region

    try:
        numbers = [float(part) for part in text.replace(",", " ").split()]
        return Region(low=(numbers[0], numbers[1], numbers[2]), high=(numbers[3], numbers[4], numbers[5]))
    except (ValueError, IndexError, ValidationError) as error:
        words = error.errors()[0]["msg"] if isinstance(error, ValidationError) else "six numbers are needed"
        reason = words.removeprefix("Value error, ")
        raise UsageError(f"the region is {text!r} ({reason}); expected x0 y0 z0 x1 y1 z1, low corner first") from None


def result_json(result: FindObjectResult) -> dict[str, Any]:
    """The object that ``find --json`` prints."""
    return {
        "status": result.status.value,
        "code": int(result.code),
        "stamp_ns": result.header.stamp.ns,
        "frame_id": result.header.frame_id,
        "message": result.message,
        "objects": [_object_json(found) for found in result.objects],
        "obstacles": [_obstacle_json(obstacle) for obstacle in result.obstacles],
        "p_absent": result.p_absent,
        "deadline_passed": result.deadline_passed,
        "report": result.report,
        "timings_ms": result.timings_ms,
    }


def _object_json(found: DetectedObject) -> dict[str, Any]:
    place, turn = found.pose.position, found.pose.orientation
    return {
        "id": found.id,
        "type": found.type,
        "code": found.code,
        "score": found.score,
        "position": [place.x, place.y, place.z],
        "orientation": [turn.x, turn.y, turn.z, turn.w],
        "size": list(found.size),
        "covariance": list(found.covariance),
        "covariance_support": found.covariance_support,
        "covariance_world": found.covariance_world,
        "visible_fraction": found.visible_fraction,
        "measured_height": found.measured_height,
        "support": None if found.support is None else found.support.model_dump(),
        "truncated": found.truncated,
        "occluded": found.occluded,
        "runner_up": found.runner_up,
        "equivalent_poses": [pose.model_dump() for pose in found.equivalent_poses],
    }


def merged_json(answer: MergedAnswer) -> dict[str, Any]:
    """The object that ``find --finder all --json`` prints."""
    return {
        "status": answer.status.value,
        "objects": [_merged_object_json(thing) for thing in answer],
        "finders": {result.finder: result_json(result) for result in answer.results},
        "silent": dict(answer.silent),
    }


def _merged_object_json(thing: MergedObject) -> dict[str, Any]:
    return {
        **_object_json(thing.best),
        "frame_id": thing.frame_id,
        "finder": thing.finder,
        "others": [{"finder": name, **_object_json(found)} for name, found in thing.others],
        "disagreement": thing.disagreement_m,
        "denied": list(thing.denied),
    }


def describe_merged(answer: MergedAnswer) -> str:
    """The answers of all finders in words."""
    lines = [line for thing in answer for line in _describe_merged_one(thing)]
    lines += [f"{r.finder}: {describe(r)}" for r in answer.results if not answer or r.status.value == "cannot_tell"]
    lines += [f"{name} gave no answer: {why}" for name, why in answer.silent.items()]
    return "\n".join(lines)


def _describe_merged_one(thing: MergedObject) -> list[str]:
    lines = [f"{_describe_one(thing.best, thing.frame_id)}\n  found by     {thing.finder}"]
    if thing.others:
        names = ", ".join(f"{name} (probability {found.score:.3f})" for name, found in thing.others)
        lines.append(f"  and by       {names}; places differ by up to {thing.disagreement_m * 1e3:.2f} mm")
    if thing.denied:
        lines.append(f"  not found by {', '.join(thing.denied)}")
    return lines


def _obstacle_json(obstacle: Obstacle) -> dict[str, Any]:
    place, turn = obstacle.pose.position, obstacle.pose.orientation
    return {
        "label": obstacle.label,
        "points": obstacle.points,
        "position": [place.x, place.y, place.z],
        "orientation": [turn.x, turn.y, turn.z, turn.w],
        "size": list(obstacle.size),
    }


def describe(result: FindObjectResult) -> str:
    """The answer in words."""
    if result.objects:
        return "\n".join(_describe_one(found, result.header.frame_id) for found in result.objects)
    words = result.status.value.replace("_", " ")
    if result.message:
        return f"{words}: {result.message}"
    if not result.report.get("supports", True):
        return f"{words}: no surface was seen that things could stand on"
    return f"{words} (probability of absence {result.p_absent:.3f})" if result.p_absent else words


_WAY = {
    "stamp_to_sent": "from the stamp until sent",
    "sent_to_received": "on the way",
    "wait_for_cloud": "waited for the cloud",
    "in_finder": "in the finder",
    "age_of_cloud": "from the stamp to the answer",
}


def _way(result: FindObjectResult) -> str:
    """How long each stage took from the sensor's stamp to the answer; empty where nothing was on a network."""
    parts = [f"{result.timings_ms[name]:.1f} ms {words}" for name, words in _WAY.items() if name in result.timings_ms]
    return ", ".join(parts)


def _describe_one(found: DetectedObject, frame: str) -> str:
    place, turn = found.pose.position, found.pose.orientation
    deviations = [math.sqrt(max(found.covariance[7 * axis], 0.0)) * 1e3 for axis in range(3)]
    flags = "".join(f", {word}" for word in ("truncated", "occluded") if getattr(found, word))
    return (
        f"{found.type}, probability {found.score:.3f}, {found.visible_fraction:.0%} visible{flags}\n"
        f"  position     {numbers((place.x, place.y, place.z))} m in {frame}, +- {numbers(deviations, 2)} mm\n"
        f"  orientation  {numbers((turn.x, turn.y, turn.z, turn.w))} x y z w"
    )
