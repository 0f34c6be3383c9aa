"""Which cases of the whole matrices there are."""


def pytest_generate_tests(metafunc):
    """Give a campaign over a whole matrix its cases, or one where ``-m`` leaves campaigns out.

    To make thousands and then to deselect them takes each process that gathers the suite seconds.
    """
    names, cases, ids = getattr(metafunc.function, "matrix", (None, None, None))
    if names is None:
        return
    left_out = "not campaign" in metafunc.config.option.markexpr
    metafunc.parametrize(names, [names] if left_out else cases(), ids=ids)
