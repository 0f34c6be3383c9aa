"""Cases of the complete test matrices."""


def pytest_generate_tests(metafunc):
    """Give a campaign its complete matrix, or one case if ``-m`` leaves campaigns out.

    Creating thousands of cases and deselecting them costs each process that collects the suite
    seconds.
    """
    names, cases, ids = getattr(metafunc.function, "matrix", (None, None, None))
    if names is None:
        return
    left_out = "not campaign" in metafunc.config.option.markexpr
    metafunc.parametrize(names, [names] if left_out else cases(), ids=ids)
