"""Keep what is seen: a cloud as a file, the view as a picture, the scene as a page that opens from disk."""

from __future__ import annotations

import io
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from viser import Icon

from zsight.errors import ZsightError
from zsight_core.errors import CoreError
from zsight_core.transform import quaternion

if TYPE_CHECKING:
    import viser

    from zsight.viewer.clouds import Clouds
    from zsight.viewer.frames import Frames

__all__ = ["Keep"]

_SUFFIXES = (".pcd", ".ply")
_RENDER_WAIT = 20.0  # seconds that a browser may take for a picture


class Keep:
    """Buttons that download; with a folder on the viewer's host clouds are written there too."""

    def __init__(self, server: viser.ViserServer, frames: Frames, clouds: Clouds, folder: str) -> None:
        """Args: server of the page; frames, clouds: what is kept; folder, may be empty."""
        self._server, self._frames, self._clouds = server, frames, clouds
        self._folder = Path(folder).expanduser() if folder else None
        gui = server.gui
        self._camera = gui.add_dropdown("Camera", ("(none)",))
        for suffix in _SUFFIXES:
            button = gui.add_button(f"Cloud as {suffix}", icon=Icon.DOWNLOAD)
            button.on_click(partial(self._keep_cloud, suffix))
        gui.add_button("Picture of the view", icon=Icon.PHOTO).on_click(self._keep_picture)
        gui.add_button("Page of the scene", icon=Icon.FILE_CODE, hint="One file that opens from disk").on_click(
            self._keep_page
        )
        self._words = gui.add_markdown("")

    def update(self) -> None:
        """Offer the cameras that are there."""
        names = tuple(self._clouds.cameras()) or ("(none)",)
        if tuple(self._camera.options) != names:
            self._camera.options = names

    def _keep_cloud(self, suffix: str, event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        cloud = self._clouds.newest(str(self._camera.value))
        if cloud is None:
            self._words.content = "There is no cloud to keep: is a camera running?"
            return
        from zsight.cloud_input import write
        from zsight.convert import points_of

        name = f"{self._camera.value}-{cloud.header.stamp.ns}{suffix}"
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / name
            try:
                write(path, points_of(cloud), viewpoint=self._viewpoint(cloud.header.frame_id))
                content = path.read_bytes()
                if self._folder is not None:
                    self._folder.mkdir(parents=True, exist_ok=True)
                    (self._folder / name).write_bytes(content)
            except (ZsightError, CoreError, OSError) as error:
                self._words.content = f"not kept: {error}"
                return
        where = f", also in {self._folder}" if self._folder is not None else ""
        self._download(event, name, content)
        self._words.content = f"{name}: {cloud.height} x {cloud.width} points, {len(content) / 1e6:.1f} MB{where}"

    def _viewpoint(self, frame: str) -> tuple[float, ...]:
        """PCD's: where the camera stands in the fixed frame, its quaternion with w first."""
        T = self._frames.T_fixed(frame)
        if T is None:
            return (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
        x, y, z, w = (float(value) for value in quaternion(T))
        return (float(T[0, 3]), float(T[1, 3]), float(T[2, 3]), w, x, y, z)

    def _keep_picture(self, event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        from PIL import Image

        client = event.client
        if client is None:
            return
        size = (client.camera.image_height, client.camera.image_width)
        try:
            pixels = client.get_render(*size, transport_format="png", timeout=_RENDER_WAIT)
        except (TimeoutError, RuntimeError) as error:
            self._words.content = f"no picture: the browser does not draw ({error})"
            return
        picture, png = Image.fromarray(pixels), io.BytesIO()
        paper = Image.new("RGBA", picture.size, "white")
        paper.paste(picture, mask=picture if picture.mode == "RGBA" else None)
        paper.convert("RGB").save(png, "PNG")
        self._download(event, f"view-{time.strftime('%Y%m%d-%H%M%S')}.png", png.getvalue())

    def _keep_page(self, event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        page = self._server.scene.as_html().encode()
        self._download(event, f"scene-{time.strftime('%Y%m%d-%H%M%S')}.html", page)
        self._words.content = f"the scene as a page: {len(page) / 1e6:.1f} MB; open it from disk"

    def _download(self, event: viser.GuiEvent[viser.GuiButtonHandle], name: str, content: bytes) -> None:
        if event.client is not None:
            event.client.send_file_download(name, content, save_immediately=True)
