"""Pictures of clouds with objects drawn over them, for the command line and for reports."""

from zsight_core.picture.drawings import Drawing, Legend, Outline, Triad
from zsight_core.picture.eye import Eye, eye_around, own_eye
from zsight_core.picture.picture import draw, png_of, save_png, warm_up

__all__ = [
    "Drawing",
    "Eye",
    "Legend",
    "Outline",
    "Triad",
    "draw",
    "eye_around",
    "own_eye",
    "png_of",
    "save_png",
    "warm_up",
]
