"""A registry of configurations by name, as draccus has it."""


class ChoiceRegistry:
    """Its subclasses are chosen by ``type``."""

    @classmethod
    def register_subclass(cls, name):
        def register(subclass):
            subclass.type = name
            return subclass

        return register
