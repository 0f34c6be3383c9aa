from mujoco import GLContext

__all__ = ["GLContext"]
