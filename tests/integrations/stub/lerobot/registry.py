"""A registry of configurations by name, like draccus."""


class ChoiceRegistry:
    """A class whose subclasses are chosen by ``type``."""

    @classmethod
    def register_subclass(cls, name):
        def register(subclass):
            subclass.type = name
            return subclass

        return register
