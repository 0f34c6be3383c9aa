"""Pictures that a person opens: a solution, the curves of its errors, the reachable region."""
