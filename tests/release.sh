#!/usr/bin/env bash
# Wheel and source distribution, each installed into an empty environment of each Python, and what a user does first there:
# the demonstration, then recordings of their own imported and identified.
set -euo pipefail
cd "$(dirname "$0")/.."
place=$PWD/${1:-.venv-release}

found=()
for minor in 11 12 13; do
  for candidate in "python3.$minor" "$HOME"/.pyenv/versions/"3.$minor".*/bin/python; do
    if "$candidate" -c "import sys; sys.exit(sys.version_info[:2] != (3, $minor))" 2> /dev/null; then
      found+=("$candidate")
      break
    fi
  done
done
read -r -a pythons <<< "${PYTHONS:-${found[*]}}"
if [ ${#pythons[@]} -eq 0 ]; then
  echo "no Python 3.11, 3.12 or 3.13 is found; name one: make PYTHONS=/path/to/python release-check" >&2
  exit 1
fi

pip() { "$place/bin/python" -m pip --disable-pip-version-check install --quiet "$@"; }
rm -rf "$place" dist
"${pythons[0]}" -m venv "$place"
pip build
"$place/bin/python" -m build --outdir dist > /dev/null
for python in "${pythons[@]}"; do
  for package in dist/*.whl dist/*.tar.gz; do
    echo "== $package on $("$python" --version)"
    "$python" -m venv --clear "$place"
    pip "$package"
    (
      cd "$place"
      bin/bayesid --version
      bin/bayesid demo --out demo
      tables=$(echo demo/*/identification.csv)
      bin/bayesid import "$tables" "${tables/identification/validation}" --urdf "$(dirname "$tables")/robot.urdf" \
        --joints joint1,joint2 --sensor base --out mine
      bin/bayesid identify mine --out found
      bin/python -c "import bayesid; print(repr(bayesid.load('found')))"
    )
  done
done
echo "installs and works on: ${pythons[*]}"
