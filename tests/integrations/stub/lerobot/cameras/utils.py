def make_cameras_from_configs(camera_configs):
    return {name: config.make() for name, config in camera_configs.items()}
