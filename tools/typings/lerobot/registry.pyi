from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

class ChoiceRegistry:
    @classmethod
    def register_subclass(cls, name: str) -> Callable[[type[T]], type[T]]: ...
