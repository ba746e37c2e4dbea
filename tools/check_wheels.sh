#!/bin/sh
# Build what is shipped into dist/, install it outside the checkout as a user would, and run it there.
set -eu
bin=$(cd "$1/bin" && pwd)
root=$(pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

echo "wheels and sdists"
rm -rf dist
for project in toolkit/generator .; do
    (cd "$project" && "$bin/hatchling" build -d "$root/dist" >/dev/null)
done
for sdist in dist/*.tar.gz; do # a wheel made from the sdist is the wheel made from the checkout
    name=$(basename "$sdist" .tar.gz)
    tar -xzf "$sdist" -C "$work"
    (cd "$work/$name" && "$bin/hatchling" build -t wheel -d "$work/from_sdist" >/dev/null)
    cmp "dist/$name-py3-none-any.whl" "$work/from_sdist/$name-py3-none-any.whl"
done
ls dist

install() { # ENVIRONMENT DISTRIBUTION; without --refresh-package uv takes a wheel of the same version from its cache
    "$bin/uv" venv --quiet --python "$bin/python" "$1"
    VIRTUAL_ENV=$1 "$bin/uv" pip install --quiet --find-links "$root/dist" --constraint "$root/requirements.txt" \
        --refresh-package openlongtail --refresh-package olt-generator "$2"
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
"$work/toolkit/bin/olt" --version
"$work/toolkit/bin/olt" doctor
"$work/toolkit/bin/olt" closed-loop run nominal:1
"$work/toolkit/bin/olt" demo --quick --out demo
test -s demo/summary.json
test -s demo/report.html
