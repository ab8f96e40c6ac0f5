#!/bin/sh
# SPDX-License-Identifier: MIT
# Copyright (c) The fenicsmpm developers
#
# Builds the source distribution and the wheel, and checks both as a user gets them:
#     packaging/check.sh [DIRECTORY]                      beside the dolfinx that ./run finds
#     FENICSMPM_ENV=wheel packaging/check.sh [DIRECTORY]  beside the dolfinx wheel
# 1. The files in them are those that git knows, and PyPI accepts the metadata.
# 2. The wheel goes into a new venv beside dolfinx; pip finds every dependency there.
# 3. The example of the README runs with it in an empty directory.
# 4. mypy sees the types of the installed package from outside.
# If a directory is given, both files are left there. Start it outside of ./run: it needs git.
set -eu

repo=$(cd -P -- "$(dirname -- "$0")/.." && pwd -P)
tmp=$(mktemp -d)
trap 'rm -rf "$tmp"' EXIT
trap 'exit 130' INT TERM
say() { printf -- '--- %s\n' "$*"; }
# run COMMAND...: where dolfinx is; not what other packages on the way here set
run() { env -u PYTHONPATH "$repo/run" "$@"; }
quietly() { "$@" >"$tmp/log" 2>&1 || { cat "$tmp/log"; exit 1; }; }
tool() { run env PYTHONPATH="$tmp/tools" python -m "$@"; }

say "build"
quietly run python -m pip install --target "$tmp/tools" build==1.3.0 twine==6.2.0 mypy==1.18.2
# of a clean copy, so that nothing is left in the tree
mkdir "$tmp/source" "$tmp/empty"
git -C "$repo" ls-files >"$tmp/known"
tar -C "$repo" -cf - -T "$tmp/known" | tar -C "$tmp/source" -xf -
mkdir "$tmp/source/scratch" "$tmp/source/output" # what must not get in
touch "$tmp/source/scratch/notes.py" "$tmp/source/output/picture.png" "$tmp/source/fenicsmpm/left_over.so"
quietly tool build --outdir "$tmp/dist" "$tmp/source"
ls -l "$tmp/dist"

say "contents and metadata"
tool twine check --strict "$tmp"/dist/*
run python - "$tmp/dist" "$tmp/known" <<'END'
import pathlib, sys, tarfile, zipfile

folder, known = pathlib.Path(sys.argv[1]), set(pathlib.Path(sys.argv[2]).read_text().split("\n")) - {""}
(sdist,), (wheel,) = folder.glob("*.tar.gz"), folder.glob("*.whl")
with tarfile.open(sdist) as archive:
    files = {file.name.partition("/")[2] for file in archive if file.isfile()}
made = {name for name in files if ".egg-info/" in name} | {"PKG-INFO", "setup.cfg"}
wrong = {f"sdist, not in git: {name}" for name in files - made - known}
wrong |= {f"sdist, missing: {name}" for name in known - files - {".gitignore"}}
with zipfile.ZipFile(wheel) as archive:
    files = {name for name in archive.namelist() if ".dist-info/" not in name}
wrong |= {f"wheel, wrong: {name}" for name in files ^ {n for n in known if n.startswith("fenicsmpm/")}}
print("\n".join(sorted(wrong)) or "the files are those that git knows")
sys.exit(bool(wrong))
END

say "installation beside dolfinx"
run python -m venv --system-site-packages --without-pip "$tmp/venv"
# A venv made from a venv, as that of the dolfinx wheel, does not see the packages of its parent.
run python - "$tmp/venv" <<'END'
import pathlib, sys
import dolfinx

parent = str(pathlib.Path(dolfinx.__file__).parents[1])
(packages,) = pathlib.Path(sys.argv[1], "lib").glob("python*/site-packages")
(packages / "dolfinx.pth").write_text(f"import site; site.addsitedir({parent!r})\n")
END
# --no-index: every dependency must be there
run python -m pip --python "$tmp/venv/bin/python" install --quiet --no-index "$tmp"/dist/*.whl
cd "$tmp/empty"
run "$tmp/venv/bin/python" -c "
import dolfinx, fenicsmpm
assert fenicsmpm.__file__.startswith('$tmp/venv/'), fenicsmpm.__file__
print('fenicsmpm', fenicsmpm.__version__, 'beside dolfinx', dolfinx.__version__)"

say "example of the README"
# shellcheck disable=SC2016  # backquotes of Markdown
sed -n '/^```python$/,/^```$/{/^```/!p}' "$repo/README.md" >example.py
run "$tmp/venv/bin/python" example.py

say "types from outside"
cat >client.py <<'END'
from fenicsmpm import ExplicitMPM, MaterialPoints, forms, points


def mean_weight(body: MaterialPoints) -> float:
    return body.volume() / body.size_global


def ends(sim: ExplicitMPM, until: float) -> list[float]:
    return [step.time for step in sim.run(until)]


wrong: str = points.fill  # mypy must find this
also_wrong: int = forms.form  # and this
END
found=$(tool mypy --python-executable "$tmp/venv/bin/python" --strict --follow-imports silent client.py 2>&1) || :
printf '%s\n' "$found"
for line in "client.py:12: error: Incompatible types" "client.py:13: error: Incompatible types" "Found 2 errors in 1 file"; do
    case $found in *"$line"*) ;; *) echo "mypy should have said: $line"; exit 1 ;; esac
done

if [ $# -gt 0 ]; then cp "$tmp"/dist/* "$1"; fi
say "all passed"
