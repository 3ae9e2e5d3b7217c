"""Run by the interpreter that has rclpy: reads CDR messages and writes them again; see test_readers.py."""

import sys
from pathlib import Path

from rclpy.serialization import deserialize_message, serialize_message  # type: ignore[import-not-found]
from sensor_msgs.msg import CameraInfo, PointCloud2  # type: ignore[import-not-found]

for kind, name in ((PointCloud2, "cloud"), (CameraInfo, "info")):
    payload = Path(sys.argv[1], f"{name}.cdr").read_bytes()
    message = deserialize_message(payload, kind)
    Path(sys.argv[1], f"{name}.again").write_bytes(bytes(serialize_message(message)))
    if kind is PointCloud2:
        Path(sys.argv[1], "cloud.data").write_bytes(bytes(message.data))
        print(
            message.header.stamp.sec,
            message.header.stamp.nanosec,
            message.header.frame_id,
            message.height,
            message.width,
        )
