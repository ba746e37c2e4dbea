#!/bin/sh
# Make the environment from the pinned versions: by uv, from the PATH or else from the package index; by pip where uv fails.
set -eu
venv=$1
python=${PYTHON:-python3}
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || {
    echo "$python is older than Python 3.11; set PYTHON to a newer one" >&2
    exit 1
}
"$python" -m venv "$venv"
pip="$venv/bin/python -m pip --quiet --disable-pip-version-check"
uv=$(command -v uv || true)
if [ -z "$uv" ] && $pip install "$(grep '^uv==' requirements.txt)"; then
    uv=$venv/bin/uv
fi
if [ -n "$uv" ]; then
    # Compiled once here, as pip does, instead of by every process that imports torch.
    VIRTUAL_ENV=$venv "$uv" pip install --quiet --compile-bytecode --requirement requirements.txt
    VIRTUAL_ENV=$venv "$uv" pip install --quiet --no-deps --no-build-isolation --editable toolkit/generator --editable .
else
    $pip install --requirement requirements.txt
    $pip install --no-deps --no-build-isolation --editable toolkit/generator --editable .
fi
