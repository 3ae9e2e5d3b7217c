"""Ask a running finder, with progress for people."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from zsight.bus import Bus
from zsight.bus.zenoh_link import open_link
from zsight.client import CellClient, answer_of
from zsight.errors import ZsightError
from zsight_protocol.channels import Cell
from zsight_protocol.find_object import Capture

if TYPE_CHECKING:
    from zsight.client import FindOptions
    from zsight.merging import MergedAnswer
    from zsight.network import Network
    from zsight_protocol.action import Update
    from zsight_protocol.find_object import FindObjectResult
    from zsight_protocol.geometry import Region

__all__ = ["ask", "ask_all"]


def ask(
    network: Network,
    object_type: str,
    *,
    finder: str,
    frame: str,
    timeout: float,
    known_height: float | None,
    region: Region | None,
    new: bool,
    maximum: int,
    picture: Path | None,
    quiet: bool,
) -> FindObjectResult:
    """The answer of a finder; Ctrl-C cancels the goal there."""
    with CellClient(Bus(open_link(network), Cell(network.namespace))) as cell:
        call = cell.start_find(
            object_type,
            finder=finder,
            frame=frame,
            known_height=known_height,
            region=region,
            capture=Capture.NEW if new else Capture.LAST,
            maximum=maximum,
            timeout=timeout,
        )
        try:
            result = answer_of(call.wait((lambda _: None) if quiet or not sys.stderr.isatty() else _show))
        except KeyboardInterrupt:
            with contextlib.suppress(ZsightError):
                call.cancel()
            raise
        if picture is not None:
            from zsight.pictures import draw_live

            draw_live(cell.bus, result, picture)
        return result


def ask_all(network: Network, object_type: str, *, new: bool, **options: Unpack[FindOptions]) -> MergedAnswer:
    """The joined answers of all finders."""
    options["capture"] = Capture.NEW if new else Capture.LAST
    with CellClient(Bus(open_link(network), Cell(network.namespace))) as cell:
        return cell.find_all(object_type, **options)


def _show(update: Update[FindObjectResult]) -> None:
    line = "" if update.final else f"{update.stage} {update.fraction:.0%}"
    sys.stderr.write(f"\r\x1b[K{line}")  # back to the start of the line, which is cleared
    sys.stderr.flush()
