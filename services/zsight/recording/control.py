"""What recorders and players have in common: they are told what to do, and tell how they stand."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Generic, TypeVar

from zsight.bus.request_queue import RequestQueue
from zsight.errors import ZsightError
from zsight_protocol.codec import decode, encode
from zsight_protocol.errors import ProtocolError
from zsight_protocol.message import Message

if TYPE_CHECKING:
    from collections.abc import Callable

    from zsight.bus import Bus, RawRequest
    from zsight.bus.link import Closable

__all__ = ["Control"]

log = logging.getLogger(__name__)

_AT_ONCE = 4  # requests: how it stands is told while a file is opened or closed

Request = TypeVar("Request", bound=Message)
State = TypeVar("State", bound=Message)


class Control(Generic[Request, State]):
    """Serves the requests of one recorder or player, and publishes its state."""

    def __init__(
        self,
        bus: Bus,
        asked: tuple[str, type[Request]],
        told: tuple[str, type[State]],
        do: Callable[[Request], State],
        state: Callable[[], State],
    ) -> None:
        """Nobody is answered before ``serve`` is called.

        Args:
            bus: bus of the cell.
            asked: key and kind of the requests.
            told: key and kind of what is told.
            do: does what a request asks, and returns how it stands afterwards; what it raises refuses the request.
            state: how it stands.
        """
        self._bus = bus
        self._key, self._request = asked
        self._do = do
        self._state = state
        self._status = bus.writer(*told)
        self._server: Closable | None = None
        # Opening, seeking and closing wait for files.
        self._requests = RequestQueue("request", threads=_AT_ONCE)

    def serve(self) -> None:
        """Begin to answer; what is asked may come at once."""
        self._server = self._bus.serve(self._key, lambda request: self._requests.put(request, self._answer))

    def tell(self) -> None:
        """Tell everybody how it stands."""
        try:
            self._status.send(self._state())
        except ZsightError as error:
            log.debug("not told: %s", error)

    def close(self) -> None:
        """Answer no more."""
        if self._server is not None:
            self._server.close()
        self._requests.close()

    def _answer(self, request: RawRequest) -> None:
        try:
            state = self._do(decode(self._request, request.payload))
        except (ZsightError, ProtocolError) as error:
            log.warning("refused a request: %s", error)
            state = self._state().model_copy(update={"ok": False, "message": str(error)})
        request.reply(encode(state))
        request.close()
