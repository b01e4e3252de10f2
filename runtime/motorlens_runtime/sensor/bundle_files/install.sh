#!/bin/sh
# Installs motorlens from this directory alone; no network is used. As root it also becomes a service.
# usage: sh install.sh [--prefix DIR] [--no-service]
set -eu
here=$(cd "$(dirname "$0")" && pwd)
prefix=/opt/motorlens
etc=/etc/motorlens
service=yes
while [ $# -gt 0 ]; do
    case $1 in
    --prefix) prefix=${2:?--prefix needs a directory}; shift 2 ;;
    --no-service) service=no; shift ;;
    *) echo "install.sh: unknown option $1; known: --prefix DIR, --no-service" >&2; exit 2 ;;
    esac
done
fail() { echo "install.sh: $*" >&2; exit 1; }

cd "$here"
sha256sum --check --strict --quiet SHA256SUMS || fail "a file differs from SHA256SUMS; copy the directory again"
[ "$(uname -m)" = "@MACHINE@" ] || fail "made for @MACHINE@, this is $(uname -m); make a bundle with --target $(uname -m)"
python=
for candidate in python@PYTHON@ python3; do
    if [ "$("$candidate" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null)" = "@PYTHON@" ]; then
        python=$candidate
        break
    fi
done
[ -n "$python" ] || fail "needs Python @PYTHON@, which is not here; make a bundle with --python VERSION"
if [ "$service" = yes ] && [ "$(id -u)" != 0 ]; then
    fail "run as root to install the service, or with --no-service --prefix DIR"
fi

mkdir -p "$prefix"
# pip comes along as a wheel, so that neither ensurepip nor a package of the system is needed.
"$python" -m venv --clear --without-pip "$prefix/venv"
pip=$(echo "$here"/wheels/pip-*.whl)
"$prefix/venv/bin/python" "$pip/pip" --isolated install --quiet --disable-pip-version-check --no-index \
    --find-links "$here/wheels" @REQUIREMENTS@
# The C core, if it came along; without it Python computes the same, but slower.
if [ -e "$here/motorlens-@MACHINE@.so" ]; then
    core=$("$prefix/venv/bin/python" -c 'from motorlens_runtime.sensor import core_library; print(core_library.source_folder())')
    cp "$here/motorlens-@MACHINE@.so" "$core/"
fi
cp "$here/@SENSOR@" "$prefix/@SENSOR@"
cp "$here/uninstall.sh" "$prefix/uninstall.sh"
"$prefix/venv/bin/motorlens" doctor --sensor "$prefix/@SENSOR@" --seconds 0.2

if [ "$service" = yes ]; then
    mkdir -p "$etc"
    # A configuration that is there already is the owner's.
    [ -e "$etc/motorlens.env" ] || cp "$here/motorlens.env" "$etc/motorlens.env"
    sed -e "s|@PREFIX@|$prefix|g" -e "s|@ETC@|$etc|g" "$here/motorlens.service" >/etc/systemd/system/motorlens.service
    cp "$here/99-motorlens.rules" /etc/udev/rules.d/99-motorlens.rules
    udevadm control --reload 2>/dev/null || true
    udevadm trigger --sysname-match=cpu_dma_latency 2>/dev/null || true  # it is there already, unlike a drive
    systemctl daemon-reload
    systemctl enable --now motorlens.service
    echo "motorlens runs as a service: systemctl status motorlens, settings in $etc/motorlens.env"
else
    echo "motorlens is installed: $prefix/venv/bin/motorlens run --source ... --sensor $prefix/@SENSOR@"
fi
