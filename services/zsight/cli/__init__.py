"""The command line: ``zsight``."""

from __future__ import annotations

import sys
from typing import NoReturn

import typer

from zsight.cli.application import app
from zsight.errors import ZsightError

__all__ = ["main"]


def main() -> NoReturn:
    """Run the command and leave with its exit code; users see words, never a traceback."""
    from pydantic import ValidationError

    from zsight_core.errors import CoreError
    from zsight_protocol.errors import ProtocolError

    try:
        code = app(standalone_mode=False)
    except (ZsightError, CoreError, ProtocolError) as error:
        _say_error(str(error))
        code = getattr(error, "exit_code", 2)
    except ModuleNotFoundError as error:
        _say_error(f"{error.name} is not installed; it comes with: pip install 'zsight[all]'")
        code = 2
    except ImportError as error:
        _say_error(str(error))
        code = 2
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        _say_error(f"{'.'.join(map(str, first['loc']))} is {first['input']!r}: {first['msg']}")
        code = 2
    except (KeyboardInterrupt, typer.Abort):
        code = 130
    except BrokenPipeError:
        code = 0
    except Exception as error:
        if not hasattr(error, "format_message"):
            raise
        error.show()  # type: ignore[attr-defined]  # click's usage errors print themselves
        code = 2
    if "zenoh" in sys.modules:
        from zsight.shared_memory import leave

        leave()
    sys.exit(code if isinstance(code, int) else 0)


def _say_error(message: str) -> None:
    print(f"zsight: {message}", file=sys.stderr)
