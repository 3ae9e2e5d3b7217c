"""Draws outlines, triads and text over a picture, at twice its size so that lines come out smooth."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from zsight_core.picture.drawings import Colour, Drawing, Legend, Outline, Triad
from zsight_core.solid import Solid, solid_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.picture.eye import Projection

__all__ = ["overlay"]

FINE = 2  # canvas pixels a picture pixel
INK, PAPER = (240, 243, 246), (13, 17, 23)
AXES: tuple[tuple[str, Colour], ...] = (("x", (235, 64, 52)), ("y", (76, 187, 84)), ("z", (70, 130, 255)))
CREASE = np.cos(np.radians(30))  # edges between faces that turn less are not drawn

Point = tuple[float, float]
Area = tuple[float, float, float, float]


def overlay(image: NDArray[np.uint8], drawings: tuple[Drawing, ...], projection: Projection) -> NDArray[np.uint8]:
    """Draw over an image (rows, columns, 3).

    Labels come last, so that no line crosses them. What lies behind the eye is left out.
    """
    canvas = _Canvas(image, projection)
    for drawing in drawings:
        if isinstance(drawing, Outline):
            canvas.outline(drawing)
    for drawing in drawings:
        if isinstance(drawing, Triad):
            canvas.triad(drawing)
    canvas.write_labels()
    for drawing in drawings:
        if isinstance(drawing, Legend):
            canvas.legend(drawing)
    return canvas.image()


class _Canvas:
    """A picture at twice its size, and the labels that wait to be written."""

    def __init__(self, image: NDArray[np.uint8], projection: Projection) -> None:
        self.projection = projection
        height, width = image.shape[:2]
        self.width, self.height = width * FINE, height * FINE
        self.picture = Image.fromarray(image).resize((self.width, self.height), Image.Resampling.NEAREST)
        self.pen = ImageDraw.Draw(self.picture, "RGBA")
        self.scale = height / 720 * FINE  # lengths on the canvas are those of a picture 720 pixels high
        self.labels: list[tuple[Point, str, Colour]] = []
        self.taken: list[Area] = []

    def image(self) -> NDArray[np.uint8]:
        return np.asarray(self.picture.reduce(FINE), dtype=np.uint8)

    def font(self, size: float) -> ImageFont.ImageFont | ImageFont.FreeTypeFont:
        return ImageFont.load_default(size * self.scale)

    def place(self, xyz_points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Canvas columns, rows and depths (N, 3) of points (N, 3)."""
        pixels = self.projection.pixels(xyz_points)
        pixels[:, :2] = (pixels[:, :2] + 0.5) * FINE
        return pixels

    def outline(self, drawing: Outline) -> None:
        solid = solid_of(drawing.shape)
        T = drawing.T_points_model
        vertices = solid.vertices @ T[:3, :3].T + T[:3, 3]
        corners = self.place(vertices)
        if not np.isfinite(corners).all():
            return
        seen, hidden = _visible_edges(solid, corners)
        for a, b in hidden:
            self.stroke([corners[a], corners[b]], (*drawing.colour, 70), 1.2)
        if not drawing.dashed:
            self.tint(solid, corners, drawing.colour)
        for a, b in seen:
            if drawing.dashed:
                self.dashes(corners[a], corners[b], drawing.colour)
            else:
                self.stroke([corners[a], corners[b]], (*drawing.colour, 255), 2.4)
        if drawing.label:
            top = corners[np.argmin(corners[:, 1])]
            self.labels.append(((float(top[0]), float(top[1])), drawing.label, drawing.colour))

    def tint(self, solid: Solid, corners: NDArray[np.float64], colour: Colour) -> None:
        """Lay a thin coat of colour over the faces that look at the eye."""
        low = np.floor(corners[:, :2].min(axis=0)).astype(int)
        high = np.ceil(corners[:, :2].max(axis=0)).astype(int)
        low, high = np.maximum(low, 0), np.minimum(high, [self.width, self.height])
        if (high - low < 1).any():
            return
        coat = Image.new("L", (int(high[0] - low[0]), int(high[1] - low[1])))
        pen = ImageDraw.Draw(coat)
        for face in solid.faces[_faces_eye(solid, corners)]:
            pen.polygon([(x - low[0], y - low[1]) for x, y in corners[face, :2]], fill=56)
        self.picture.paste(colour, (int(low[0]), int(low[1])), coat)

    def stroke(self, path: list[NDArray[np.float64]], colour: tuple[int, int, int, int], width: float) -> None:
        line = [(float(x), float(y)) for x, y, _ in path]
        thick = max(1, round(width * self.scale))
        self.pen.line(line, fill=colour, width=thick, joint="curve")
        if colour[3] == 255 and thick > 2:  # round ends hide the notches where lines meet
            for x, y in line:
                r = thick / 2 - 0.5
                self.pen.ellipse((x - r, y - r, x + r, y + r), fill=colour)

    def dashes(self, start: NDArray[np.float64], end: NDArray[np.float64], colour: Colour) -> None:
        length = float(np.hypot(*(end - start)[:2]))
        count = max(1, round(length / (7 * self.scale)))
        for k in range(count):
            ends = [start + (end - start) * (k + share) / count for share in (0.0, 0.55)]
            self.stroke(ends, (*colour, 230), 1.6)

    def triad(self, drawing: Triad) -> None:
        origin = drawing.T_points_frame[:3, 3]
        tips = origin + drawing.length * drawing.T_points_frame[:3, :3].T
        placed = self.place(np.vstack([origin, tips]))
        if not np.isfinite(placed).all():
            return
        farthest_first = np.argsort(-placed[1:, 2])
        for axis in farthest_first:
            name, colour = AXES[axis]
            self.arrow(placed[0], placed[axis + 1], colour)
            self.axis_name(placed[0], placed[axis + 1], name, colour)
            self.keep_free(placed[0, :2], placed[axis + 1, :2])
        x, y, _ = placed[0]
        r = 3.2 * self.scale
        self.pen.ellipse((x - r, y - r, x + r, y + r), fill=(*INK, 255))
        if drawing.label:
            self.labels.append(((float(x), float(y)), drawing.label, INK))

    def arrow(self, start: NDArray[np.float64], tip: NDArray[np.float64], colour: Colour) -> None:
        """A shaft and a head, both with a dark rim that sets them off from the cloud."""
        along = (tip - start)[:2]
        length = float(np.hypot(*along))
        if length < 2 * self.scale:
            return
        along = along / length
        across = np.array([-along[1], along[0]])
        head = min(14 * self.scale, 0.45 * length)
        neck = tip[:2] - head * along
        for rim, paint in ((2.0 * self.scale, (*PAPER, 200)), (0.0, (*colour, 255))):
            half = 0.36 * head + rim
            self.pen.line([tuple(start[:2]), tuple(neck)], fill=paint, width=round(3.4 * self.scale + 2 * rim))
            barbs = [
                tip[:2] + 1.6 * rim * along,
                neck + half * across - rim * along,
                neck - half * across - rim * along,
            ]
            self.pen.polygon([(float(x), float(y)) for x, y in barbs], fill=paint)

    def keep_free(self, start: NDArray[np.float64], tip: NDArray[np.float64]) -> None:
        """Let no label cover an arrow or the name at its tip."""
        half = 9 * self.scale
        for share in np.linspace(0, 1.1, 8):
            x, y = (float(c) for c in start + share * (tip - start))
            self.taken.append((x - half, y - half, x + half, y + half))

    def axis_name(self, start: NDArray[np.float64], tip: NDArray[np.float64], name: str, colour: Colour) -> None:
        along = (tip - start)[:2]
        length = float(np.hypot(*along))
        if length < 12 * self.scale:
            return  # the arrow points at the eye: its name would cover it
        along = along / length
        x, y = tip[:2] + 13 * self.scale * along
        light: Colour = tuple(round(c + 0.45 * (255 - c)) for c in colour)  # type: ignore[assignment]  # three of them
        self.pen.text(
            (float(x), float(y)),
            name,
            fill=light,
            font=self.font(17),
            anchor="mm",
            stroke_width=round(2 * self.scale),
            stroke_fill=PAPER,
        )

    def write_labels(self) -> None:
        """Write each label in a box above its object, higher where another label is in the way."""
        for (x, y), text, colour in sorted(self.labels, key=lambda label: -label[0][1]):
            if 0 <= x < self.width and 0 <= y < self.height:
                self.label(x, y, text, colour)

    def label(self, x: float, y: float, text: str, colour: Colour) -> None:
        font, pad = self.font(16), 7 * self.scale
        left, top, right, bottom = self.pen.textbbox((0, 0), text, font=font)
        width, height = right - left + 2 * pad, bottom - top + 1.6 * pad
        box = self.free_box(x, y, width, height)
        self.taken.append(box)
        end = (min(max(x, box[0] + pad), box[2] - pad), box[3] if y > box[3] else box[1])
        self.pen.line([(x, y), end], fill=(*colour, 255), width=round(1.4 * self.scale))
        self.pen.rounded_rectangle(
            box, radius=5 * self.scale, fill=(*PAPER, 225), outline=(*colour, 255), width=round(1.2 * self.scale)
        )
        self.pen.text((box[0] + pad - left, box[1] + 0.8 * pad - top), text, fill=INK, font=font)

    def free_box(self, x: float, y: float, width: float, height: float) -> Area:
        """The nearest place for a label, above its point if possible, that covers no arrow and no other label."""
        margin, gap = 6 * self.scale, 26 * self.scale
        choices = [
            (x + across * (width / 2 + gap) - width / 2, y - height / 2 - up * (height / 2 + gap))
            for up in (1.0, 2.2, -1.0, 3.4)
            for across in (0.0, 0.7, -0.7, 1.4, -1.4)
        ]
        boxes = []
        for wanted_left, wanted_top in choices:
            left = min(max(wanted_left, margin), self.width - width - margin)
            top = min(max(wanted_top, margin), self.height - height - margin)
            boxes.append((left, top, left + width, top + height))
        return next((box for box in boxes if not any(_overlap(box, other) for other in self.taken)), boxes[0])

    def legend(self, drawing: Legend) -> None:
        font, bold, pad, margin = self.font(16), self.font(19), 14 * self.scale, 18 * self.scale
        rows = [line.split("\t", 1) for line in drawing.lines]
        first = max((self.pen.textlength(row[0], font=font) for row in rows if len(row) == 2), default=0.0)
        gap = 16 * self.scale if first else 0.0
        widths = [
            first + gap + self.pen.textlength(row[1], font=font)
            if len(row) == 2
            else self.pen.textlength(row[0], font=font)
            for row in rows
        ]
        title_height = 30 * self.scale if drawing.title else 0.0
        widths.append(self.pen.textlength(drawing.title or "", font=bold))
        step = 24 * self.scale
        width, height = max(widths) + 2 * pad, title_height + step * len(rows) + 1.6 * pad
        x, y = margin, self.height - margin - height
        self.pen.rounded_rectangle((x, y, x + width, y + height), radius=8 * self.scale, fill=(*PAPER, 205),
                                   outline=(255, 255, 255, 40), width=round(self.scale))  # fmt: skip
        y += 0.8 * pad
        if drawing.title:
            self.pen.text((x + pad, y), drawing.title, fill=(255, 255, 255), font=bold)
            y += title_height
        for row in rows:
            if len(row) == 2:
                self.pen.text((x + pad, y), row[0], fill=(150, 160, 172), font=font)
                self.pen.text((x + pad + first + gap, y), row[1], fill=INK, font=font)
            else:
                self.pen.text((x + pad, y), row[0], fill=INK, font=font)
            y += step


def _faces_eye(solid: Solid, corners: NDArray[np.float64]) -> NDArray[np.bool_]:
    """True for faces seen from outside: counter-clockwise, that is clockwise in an image with rows going down."""
    a, b, c = (corners[solid.faces[:, k], :2] for k in range(3))
    return np.asarray((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0)


def _visible_edges(solid: Solid, corners: NDArray[np.float64]) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Ends of the edges to draw, those before the solid and those behind it: creases, and the silhouette."""
    facing = _faces_eye(solid, corners)
    a, b, c = (solid.vertices[solid.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    one, other = solid.edges[:, 2], solid.edges[:, 3]
    border = other < 0
    crease = border | ((normals[one] * normals[other]).sum(axis=1) < CREASE)
    front = facing[one] | (facing[other] & ~border)
    silhouette = ~border & (facing[one] != facing[other])
    before = solid.edges[front & (crease | silhouette), :2]
    seen = [(int(a), int(b)) for a, b in before[~_covered(solid.faces[facing], corners, before)]]
    hidden = [(int(a), int(b)) for a, b in solid.edges[~front & crease, :2]]
    return seen, hidden


def _covered(faces: NDArray[np.int32], corners: NDArray[np.float64], edges: NDArray[np.int32]) -> NDArray[np.bool_]:
    """True for edges (E, 2) whose middle lies behind one of the faces (F, 3); inverse depth is linear in an image."""
    flat = np.column_stack([corners[:, :2], 1 / corners[:, 2]])
    middle = flat[edges].mean(axis=1)[:, None, :]
    a, b, c = (flat[faces[:, k]][None] for k in range(3))
    area = _cross(b - a, c - a)
    share_b, share_c = _cross(middle - a, c - a) / area, _cross(b - a, middle - a) / area
    inside = (share_b > 0) & (share_c > 0) & (share_b + share_c < 1)
    inverse_depth = a[..., 2] + share_b * (b - a)[..., 2] + share_c * (c - a)[..., 2]
    margin = 0.03 * np.ptp(flat[:, 2])
    return np.asarray((inside & (inverse_depth > middle[..., 2] + margin)).any(axis=1))


def _cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _overlap(a: Area, b: Area) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
