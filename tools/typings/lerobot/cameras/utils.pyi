from collections.abc import Mapping

from lerobot.cameras import Camera, CameraConfig

def make_cameras_from_configs(camera_configs: Mapping[str, CameraConfig]) -> dict[str, Camera]: ...
