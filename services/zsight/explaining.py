"""Answers in words: what was seen, what came nearest, what would help."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from zsight_protocol.action import Update
    from zsight_protocol.find_object import FindObjectResult

__all__ = ["explain"]


def explain(update: Update[FindObjectResult]) -> str:
    """What is known of why a goal ended as it did."""
    result = update.result
    if result is None:
        return f"goal {update.goal_id}: {update.state.name.lower()}, at stage {update.stage or 'waiting'}"
    report: dict[str, Any] = dict(result.report)
    lines = [f"goal {update.goal_id}, {report.get('object_type', 'object')}: {result.status.value.replace('_', ' ')}"]
    if result.message:
        lines.append(f"  {result.message}")
    if "points" in report:
        lines.append(f"  {_looked_at(result, report)}")
    if report.get("transforms"):
        lines.append(f"  {_led_through(report['transforms'])}")
    lines += [f"  {warning}" for warning in report.get("warnings", [])]
    if not result.objects:
        rejected = sorted(report.get("rejected", []), key=lambda candidate: -candidate["probability"])
        lines += [f"  {_candidate(candidate)}" for candidate in rejected[:2]]
        lines += [f"  {hint}" for hint in _hints(result, report, rejected)]
    return "\n".join(lines)


def _looked_at(result: FindObjectResult, report: dict[str, Any]) -> str:
    age = result.timings_ms.get("age_of_cloud")
    when = "" if age is None else f", {age:.0f} ms old at the answer"
    return (
        f"looked at {report['points']} points of camera {report.get('camera', '?')}{when}: "
        f"{report.get('supports', 0)} support surfaces, {report.get('segments', 0)} segments, "
        f"{report.get('hypotheses', 0)} hypotheses, {report.get('refined', 0)} of them refined"
    )


def _led_through(links: list[dict[str, Any]]) -> str:
    steps = (f"{link['child']} in {link['parent']}{'' if link['static'] else ' (moving)'}" for link in links)
    return f"transforms: {', '.join(steps)}"


def _candidate(candidate: dict[str, Any]) -> str:
    x, y, z = candidate["position"]
    rival = f"; {candidate['rival']} fits better there" if candidate.get("rival") else ""
    return (
        f"nearest was one at ({x:.3f}, {y:.3f}, {z:.3f}) with probability {candidate['probability']:.2f}, "
        f"{candidate['threshold']:.2f} is needed: {candidate['agreement']:.0%} of its surface agrees, "
        f"{candidate['outline']:.0%} of its outline, {candidate['visible']:.0%} is in view{rival}"
    )


def _hints(result: FindObjectResult, report: dict[str, Any], rejected: list[dict[str, Any]]) -> list[str]:
    """What the user can do."""
    if "points" not in report or result.message:  # which says what to do
        return []
    if not report.get("supports"):
        return ["no support surface was found: does the camera see the table? Its pose: zsight calibrate level"]
    if not report.get("segments"):
        return ["nothing stands on the surfaces that are seen"]
    best = rejected[0] if rejected else None
    absent = [f"the probability of absence is {result.p_absent:.2f}"] if result.p_absent else []
    if best is None:
        return ["; ".join(["nothing of its size was seen", *absent])]
    if best["visible"] < 0.5:
        return ["most of it would be hidden or outside the image: move the camera, or what stands in front"]
    if best["outline"] < 0.5:
        return ["its outline does not fit: is the size in the catalogue right? See: zsight catalog show TYPE"]
    return absent
