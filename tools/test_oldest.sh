#!/usr/bin/env bash
# A part of the suite with every direct dependency at the lowest version that pyproject.toml allows.
# Needs uv; `make test-oldest` creates the environment .venv-oldest anew. Warnings of deprecations do
# not count, because old packages warn about newer ones.
set -euo pipefail
cd "$(dirname "$0")/.."
ENVIRONMENT=.venv-oldest
PARTS=(tests/portability tests/kinematics tests/ik tests/hardware tests/guard tests/cli tests/sim
    tests/apps/page tests/apps/remote)

uv venv --quiet --clear --python "${PYTHON:-3.11}" "$ENVIRONMENT"
uv pip compile --quiet --resolution lowest-direct --python "$ENVIRONMENT" --all-extras pyproject.toml \
    --output-file "$ENVIRONMENT/oldest.txt"
uv pip install --quiet --python "$ENVIRONMENT" --requirements "$ENVIRONMENT/oldest.txt" --editable .
uv pip install --quiet --python "$ENVIRONMENT" --overrides "$ENVIRONMENT/oldest.txt" --group test
"$ENVIRONMENT/bin/python" -m pytest -n auto --dist worksteal -q -W ignore::DeprecationWarning "${@:-${PARTS[@]}}"
