"""Commands on clouds: from files, off the wire, through the chapter's tools."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zsight.cli.options import CameraPose, Connect, Force, Intrinsics, Json, Namespace, Out, Picture, network_of
from zsight.cli.output import print_json, print_table, say
from zsight.errors import DeadlinePassed, UsageError
from zsight.words import number, numbers

if TYPE_CHECKING:
    from zsight_core.points import Points

__all__ = ["downsample", "plane", "segment", "snapshot", "tools"]

File = Annotated[Path, typer.Argument(metavar="FILE", help="A cloud: .pcd, .ply, or NAME-depth.png with its partner.")]
Ascii = Annotated[bool, typer.Option("--ascii", help="Write text instead of binary.")]
Compressed = Annotated[bool, typer.Option("--compressed", help="Write a compressed PCD.")]


def segment(
    file: File,
    labels: Annotated[
        Path | None, typer.Option("--labels", metavar="OUT.npy", help="Write int32 labels, H x W.")
    ] = None,
    camera_pose: CameraPose = "",
    intrinsics: Intrinsics = None,
    picture: Picture = None,
    json: Json = False,
    force: Force = False,
) -> None:
    """Find the support surface of a cloud and the objects that stand on it.

    Labels: -1 no data, 0 neither, 1 support, 2 and up one number an object.
    """
    from zsight import cloud_input
    from zsight.segmenting import draw, save_labels, segment_json
    from zsight_core.scene import understand

    cloud = cloud_input.read(file, intrinsics)
    points = cloud.points
    scene = understand(points, T_world_camera=cloud_input.camera_pose(camera_pose, cloud))
    if labels is not None:
        save_labels(labels, scene.labels, overwrite=force)
    if picture is not None:
        draw(picture, points, scene)
    report = segment_json(scene)
    if json:
        print_json(report)
    elif report["support"] is None:
        say("no support surface")
    else:
        normal, distance = numbers(report["support"]["normal"]), number(report["support"]["distance"])
        say(f"support: normal {normal}, distance {distance} m; {len(report['objects'])} objects")
        rows = [(o["label"], o["points"], numbers(o["centroid"], 3), numbers(o["size"], 3)) for o in report["objects"]]
        if rows:
            print_table(["label", "points", "centroid (m)", "size (m)"], rows)
    raise typer.Exit(0 if report["support"] is not None else 1)


def downsample(
    file: File,
    leaf: Annotated[float, typer.Option("--leaf", help="Edge of a voxel, metres.")] = 0.02,
    output: Out = None,
    intrinsics: Intrinsics = None,
    ascii_text: Ascii = False,
    compressed: Compressed = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Average the points, and the colours, of each voxel."""
    from zsight import cloud_input
    from zsight_core.statistics import count_finite
    from zsight_core.voxel_grid import voxel_grid

    cloud = cloud_input.read(file, intrinsics)
    smaller = voxel_grid(cloud.points, leaf)
    if output is not None:
        _write(output, smaller, cloud.viewpoint, ascii_text, compressed, force)
    report = {"points_in": count_finite(cloud.points), "points_out": int(smaller.size)}
    if json:
        print_json(report)
    else:
        say(f"{report['points_in']} points in, {report['points_out']} out")


def plane(
    file: File,
    patch: Annotated[
        tuple[int, int, int, int],
        typer.Option("--patch", metavar="U0 V0 U1 V1", help="Pixels: two corners, both included."),
    ],
    tolerance: Annotated[float, typer.Option("--tolerance", help="How near a point of the plane lies, metres.")] = 0.01,
    connected: Annotated[bool, typer.Option("--connected", help="Only points connected to the patch.")] = False,
    output: Out = None,
    above: Annotated[
        Path | None, typer.Option("--above", metavar="FILE", help="Write the points that stand above the plane here.")
    ] = None,
    intrinsics: Intrinsics = None,
    ascii_text: Ascii = False,
    compressed: Compressed = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """The plane of a patch of an organised cloud, and all points that lie in it."""
    from zsight import cloud_input, planes
    from zsight.patch_plane import plane_of_patch
    from zsight_core.above_plane import points_above
    from zsight_core.take import take

    for path in filter(None, (output, above)):
        cloud_input.require_place(path, ascii_text=ascii_text, compressed=compressed, overwrite=force)
    if output is not None and above is not None and output.resolve() == above.resolve():
        raise UsageError(f"{output} is to hold both the plane and what stands above it: name two files")
    cloud = cloud_input.read(file, intrinsics)
    settings = planes.Settings(tolerance=tolerance, connected=connected)
    found = plane_of_patch(
        cloud.points,
        _patch(cloud.points, patch),
        tolerance=settings.tolerance,
        connected_only=settings.connected,
        gap=settings.gap,
    )
    if output is not None:
        _write(output, take(cloud.points, found.members), cloud.viewpoint, ascii_text, compressed, force)
    if above is not None:
        standing = points_above(cloud.points, found.fit.plane, settings.above_low, settings.above_high, found.members)
        _write(above, standing, cloud.viewpoint, ascii_text, compressed, force)
    report: dict[str, Any] = {
        "normal": found.fit.plane.normal,
        "distance": float(found.fit.plane.distance),
        "inliers": int(found.members.sum()),
        "rms": float(found.fit.rms),
        "T_camera_plane": found.T_camera_plane.ravel(),
    }
    if json:
        print_json(report)
    else:
        say(
            f"normal {numbers(report['normal'], 5)}, distance {number(report['distance'])} m, "
            f"{report['inliers']} points, rms {1e3 * report['rms']:.2f} mm"
        )


def _patch(points: Points, corners: tuple[int, int, int, int]) -> Points:
    """The points of a rectangle of pixels, both corners included."""
    height, width = points.shape
    u0, u1 = sorted((corners[0], corners[2]))
    v0, v1 = sorted((corners[1], corners[3]))
    if height == 1:
        raise UsageError("the cloud is not organised: it has no pixels to select a patch by")
    if u0 < 0 or v0 < 0 or u1 >= width or v1 >= height:
        raise UsageError(
            f"the patch {u0} {v0} {u1} {v1} leaves the image; expected pixels 0 0 to {width - 1} {height - 1}"
        )
    return points[v0 : v1 + 1, u0 : u1 + 1]


def snapshot(
    key: Annotated[
        str, typer.Argument(metavar="[KEY]", help="Key of the clouds; those of camera kinect if not given.")
    ] = "",
    output: Out = None,
    timeout: Annotated[float, typer.Option("--timeout", help="Seconds to wait for a cloud.")] = 5.0,
    ascii_text: Ascii = False,
    compressed: Compressed = False,
    force: Force = False,
    json: Json = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """Save one cloud off the wire, with its rows and columns, holes, colours and viewpoint; never over another file."""
    from zsight import cloud_input
    from zsight.runtime import join
    from zsight.snapshots import take_snapshot

    with join(network_of(connect, namespace)) as bus:
        taken = take_snapshot(bus, key or bus.cell.points("kinect"), timeout)
    if taken is None:
        raise DeadlinePassed(
            f"no cloud on {key or 'the camera'} within {timeout:g} s: is it running? See: zsight topic list"
        )
    path = output or Path(f"cloud_{taken.stamp.ns}.pcd")
    cloud_input.write(
        path, taken.points, viewpoint=taken.viewpoint, ascii_text=ascii_text, compressed=compressed, overwrite=force
    )
    height, width = taken.points.shape
    if json:
        print_json(
            {
                "file": str(path),
                "width": width,
                "height": height,
                "frame_id": taken.frame_id,
                "stamp_ns": taken.stamp.ns,
            }
        )
    else:
        say(f"{width} x {height} points in {taken.frame_id} saved as {path}")


def _write(
    path: Path, points: Points, viewpoint: tuple[float, ...], ascii_text: bool, compressed: bool, force: bool
) -> None:
    from zsight import cloud_input

    cloud_input.write(path, points, viewpoint=viewpoint, ascii_text=ascii_text, compressed=compressed, overwrite=force)


# The chapter's tool box.

tools = typer.Typer(help="The chapter's tool box, on cloud files.", no_args_is_help=True, rich_markup_mode=None)


@tools.command()
def ellipse(
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="Write the cloud here (.pcd or .ply).")
    ],
    ascii_text: Ascii = False,
    compressed: Compressed = False,
    force: Force = False,
) -> None:
    """Make the chapter's computed cloud: an ellipse, extruded and graded in colour."""
    from zsight import cloud_input
    from zsight_core.ellipse import ellipse as make

    points = make()
    cloud_input.write(output, points, ascii_text=ascii_text, compressed=compressed, overwrite=force)
    say(f"{points.size} points saved as {output}")


@tools.command()
def info(file: File, intrinsics: Intrinsics = None, json: Json = False) -> None:
    """Size, fields, bounding box, centroid and average colour of a cloud."""
    from zsight import cloud_input
    from zsight_core import statistics
    from zsight_core.points import has_colour

    cloud = cloud_input.read(file, intrinsics)
    finite = statistics.count_finite(cloud.points)
    low, high = statistics.bounding_box(cloud.points) if finite else (None, None)
    report: dict[str, Any] = {
        "width": cloud.points.shape[1],
        "height": cloud.points.shape[0],
        "fields": list(cloud.points.dtype.names or ()),
        "finite": finite,
        "low": low,
        "high": high,
        "centroid": statistics.centroid(cloud.points) if finite else None,
        "average_colour": statistics.average_colour(cloud.points) if finite and has_colour(cloud.points) else None,
        "viewpoint": cloud.viewpoint,
    }
    if json:
        print_json(report)
    else:
        _print_report({"viewpoint (xyz, qw qx qy qz)" if k == "viewpoint" else k: v for k, v in report.items()})


def _print_report(report: dict[str, Any]) -> None:
    """Names and values, one a line; what is not known is left out."""
    print_table([], [(name, _words(value)) for name, value in report.items() if value is not None])


def _words(value: Any) -> str:
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return " ".join(_words(entry) for entry in value)
    return number(value) if isinstance(value, float) else str(value)


@tools.command()
def convert(
    file: File,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="Write the cloud here (.pcd or .ply).")
    ],
    intrinsics: Intrinsics = None,
    ascii_text: Ascii = False,
    compressed: Compressed = False,
    force: Force = False,
) -> None:
    """Write a cloud in another encoding or format."""
    from zsight import cloud_input

    cloud = cloud_input.read(file, intrinsics)
    _write(output, cloud.points, cloud.viewpoint, ascii_text, compressed, force)
    say(f"{cloud.points.size} points saved as {output}")


@tools.command(name="filter")
def filter_points(
    file: File,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="Write the cloud here (.pcd or .ply).")
    ],
    transform: Annotated[
        str, typer.Option("--transform", metavar='"X Y Z QX QY QZ QW"', help="First move the cloud into this frame.")
    ] = "",
    box: Annotated[
        tuple[float, float, float, float, float, float] | None,
        typer.Option("--box", metavar="X0 Y0 Z0 X1 Y1 Z1", help="Keep what lies in this box."),
    ] = None,
    pass_through: Annotated[
        tuple[str, float, float] | None,
        typer.Option("--pass-through", metavar="FIELD LOW HIGH", help="Keep these values."),
    ] = None,
    colour: Annotated[
        tuple[int, int, int] | None, typer.Option("--colour", metavar="R G B", help="Keep points of this colour.")
    ] = None,
    colour_tolerance: Annotated[
        float, typer.Option("--colour-tolerance", min=0, max=255, help="For each of R, G and B, 0 to 255.")
    ] = 30.0,
    intrinsics: Intrinsics = None,
    ascii_text: Ascii = False,
    compressed: Compressed = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Keep the points that pass every filter given: box, pass-through, colour."""
    from zsight import cloud_input
    from zsight.sources import pose_matrix, viewpoint_matrix, viewpoint_of
    from zsight_core import filters, rigid, statistics
    from zsight_core.transform import inverse

    if colour is not None and not all(0 <= part <= 255 for part in colour):
        raise UsageError(f"colour is {' '.join(map(str, colour))}; expected R G B, each from 0 to 255")
    cloud = cloud_input.read(file, intrinsics)
    points, viewpoint = cloud.points, cloud.viewpoint
    if transform:
        T_target_source = pose_matrix(transform)
        points = rigid.transform_points(points, T_target_source)
        # The viewpoint leads from the cloud's frame to the world, where the points are to stay.
        viewpoint = viewpoint_of(viewpoint_matrix(viewpoint) @ inverse(T_target_source))
    if box is not None:
        points = filters.box(points, box[:3], box[3:])
    if pass_through is not None:
        points = filters.pass_through(points, *pass_through)
    if colour is not None:
        points = filters.matching_colour(points, colour, colour_tolerance)
    _write(output, points, viewpoint, ascii_text, compressed, force)
    report = {"points_in": statistics.count_finite(cloud.points), "points_out": statistics.count_finite(points)}
    if json:
        print_json(report)
    else:
        say(f"{report['points_in']} points in, {report['points_out']} out")


@tools.command()
def table(
    file: File,
    camera_pose: CameraPose = "viewpoint",
    low: Annotated[float, typer.Option("--low", help="Lowest table, metres.")] = 0.6,
    high: Annotated[float, typer.Option("--high", help="Highest table, metres.")] = 1.2,
    slab: Annotated[float, typer.Option("--slab", help="Thickness of a slab, metres.")] = 0.005,
    intrinsics: Intrinsics = None,
    json: Json = False,
) -> None:
    """The book's way to a table: the fullest slab, and the plane, centroid and major axis of the points in it."""
    from zsight import cloud_input
    from zsight_core.table_height import fit_slab, table_height

    cloud = cloud_input.read(file, intrinsics)
    points = cloud.points
    T_world_camera = cloud_input.camera_pose(camera_pose, cloud)
    if T_world_camera is None:
        raise UsageError("the height of a table is one in the world: give the camera's pose in it")
    height = table_height(points, T_world_camera, low, high, slab)
    fit = fit_slab(points, T_world_camera, height - slab / 2, height + slab / 2)
    report = {
        "height": height,
        "normal": fit.plane.normal,
        "distance": fit.plane.distance,
        "centroid": fit.centroid,
        "major_axis": fit.major_axis,
        "points": fit.count,
    }
    if json:
        print_json(report)
    else:
        _print_report(report)
