"""Settings of the viewer service."""

from __future__ import annotations

from pydantic import Field

from zsight.settings import Settings as ServiceSettings

__all__ = ["Settings"]


class Settings(ServiceSettings):
    """Settings of the viewer service."""

    host: str = Field("127.0.0.1", description="address the page is served on; others than this host's are a risk")
    port: int = Field(8008, ge=0, le=65535, description="port of the page; 0 takes any that is free")
    names: str = Field("", description="further host names that the page may be asked for by, comma between")
    token: str = Field(
        "", description="what the link carries; if not given one is made and kept for this user and port"
    )
    read_only: bool = Field(False, description="a page that shows and asks nothing of the cell")
    rate: float = Field(10.0, gt=0, le=60, description="pictures of a cloud a second at most (above 0, up to 60)")
    budget: int = Field(60_000, ge=100, le=2_000_000, description="points of one cloud drawn at most (100 to 2000000)")
    frame: str = Field("", description="fixed frame at the start; the root of the tree if not given")
    folder: str = Field("", description="folder on this host that snapshots are written to as well, where given")
