#!/bin/sh
# Build what is shipped, install it outside the checkout as a user would, and run it there.
set -eu
bin=$(cd "$1/bin" && pwd)
root=$(pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

echo "building"
for project in toolkit/generator .; do
    (cd "$project" && "$bin/hatchling" build -d "$work/dist" >/dev/null)
done
mkdir "$work/unpacked"
for sdist in "$work"/dist/*.tar.gz; do
    tar -xzf "$sdist" -C "$work/unpacked"
    name=$(basename "$sdist" .tar.gz)
    (cd "$work/unpacked/$name" && "$bin/hatchling" build -t wheel -d "$work/from_sdist" >/dev/null)
    cmp "$work/dist/$name-py3-none-any.whl" "$work/from_sdist/$name-py3-none-any.whl"
done

install() { # ENVIRONMENT REQUIREMENT...
    environment=$1
    shift
    "$bin/uv" venv --quiet --python "$bin/python" "$environment"
    VIRTUAL_ENV=$environment "$bin/uv" pip install --quiet --find-links "$work/dist" --constraint "$root/requirements.txt" "$@"
}

cd "$work"
echo "the engine alone"
install "$work/engine" olt-generator
"$work/engine/bin/python" - <<'PYTHON'
import importlib
import pkgutil

import olt_generator

names = [module.name for module in pkgutil.walk_packages(olt_generator.__path__, "olt_generator.")]
for name in names:
    importlib.import_module(name)
print(f"{len(names)} modules of olt_generator {olt_generator.__version__} imported")
PYTHON

echo "the toolkit"
install "$work/toolkit" openlongtail
olt=$work/toolkit/bin/olt
"$olt" --version
"$olt" doctor >/dev/null
"$olt" closed-loop run nominal:1
"$olt" demo --quick --out demo
test -s demo/summary.json
test -s demo/report.html
"$olt" data fake --help >/dev/null
