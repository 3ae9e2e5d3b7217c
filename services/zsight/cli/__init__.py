"""The command line: ``zsight``."""

from __future__ import annotations

import errno
import os
import sys
from typing import Any, NoReturn

__all__ = ["main"]

_ADVICE = {
    errno.ENOENT: "see whether it and its folder are there",
    errno.ENOTDIR: "see whether its folder is one",
    errno.EISDIR: "name a file",
    errno.EACCES: "see who may read and write there",
    errno.EPERM: "see who may read and write there",
    errno.EROFS: "choose another place",
    errno.ENOSPC: "make room where the output goes",
    errno.EDQUOT: "make room where the output goes",
}
"""What to do about an error of the system."""


def main() -> NoReturn:
    """Run the command and leave with its exit code; users see words, never a traceback."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:  # the caller closed it: nobody wants what is said there
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_WRONLY), "w"))
    try:
        code = _run()
        if "zenoh" in sys.modules:
            from zsight.shared_memory import leave

            leave()
    except KeyboardInterrupt:
        code = 130
    try:
        sys.stdout.flush()
    except OSError:  # Python would try once more at its end, and say so
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(code if isinstance(code, int) else 0)


def _run() -> Any:
    """Run the command; what it returns, or the exit code of the error that it ended with."""
    import typer
    from pydantic import ValidationError

    from zsight.cli.application import app
    from zsight.errors import ZsightError
    from zsight_core.errors import CoreError
    from zsight_protocol.errors import ProtocolError

    try:
        return app(standalone_mode=False)
    except (ZsightError, CoreError, ProtocolError) as error:
        _say_error(str(error))
        return getattr(error, "exit_code", 2)
    except ModuleNotFoundError as error:
        _say_error(f"{error.name} is not installed; it comes with: pip install 'zsight[all]'")
    except ImportError as error:
        _say_error(str(error))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        _say_error(f"{'.'.join(map(str, first['loc']))} is {first['input']!r}: {first['msg']}")
    except typer.Abort:
        return 130
    except (BrokenPipeError, SystemExit):  # so click leaves where who reads the output has had enough, and only there
        return 0
    except OSError as error:
        parts = (error.filename, error.strerror or error, _ADVICE.get(error.errno or 0))
        _say_error(": ".join(str(part) for part in parts if part))
    except Exception as error:
        if not hasattr(error, "format_message"):
            raise
        error.show()  # type: ignore[attr-defined]  # click's usage errors print themselves
    return 2


def _say_error(message: str) -> None:
    print(f"zsight: {message}", file=sys.stderr)
