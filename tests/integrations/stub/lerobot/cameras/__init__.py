class CameraConfig:
    pass
