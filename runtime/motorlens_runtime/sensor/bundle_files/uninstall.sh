#!/bin/sh
# Removes what install.sh put there. Settings and the remembered heat stay unless --purge is given.
# usage: sh uninstall.sh [--prefix DIR] [--purge]
set -eu
prefix=/opt/motorlens
etc=/etc/motorlens
purge=no
while [ $# -gt 0 ]; do
    case $1 in
    --prefix) prefix=${2:?--prefix needs a directory}; shift 2 ;;
    --purge) purge=yes; shift ;;
    *) echo "uninstall.sh: unknown option $1; known: --prefix DIR, --purge" >&2; exit 2 ;;
    esac
done
[ -x "$prefix/venv/bin/motorlens" ] || { echo "uninstall.sh: no motorlens in $prefix" >&2; exit 1; }
if grep -qs "^ExecStart=$prefix/" /etc/systemd/system/motorlens.service; then
    systemctl disable --now motorlens.service 2>/dev/null || true
    rm -f /etc/systemd/system/motorlens.service /etc/udev/rules.d/99-motorlens.rules
    systemctl daemon-reload 2>/dev/null || true
    udevadm control --reload 2>/dev/null || true
    if [ "$purge" = yes ]; then
        rm -rf "$etc" /var/lib/motorlens /var/lib/private/motorlens
    fi
fi
rm -rf "$prefix/venv"
rm -f "$prefix/@SENSOR@" "$prefix/uninstall.sh"
rmdir "$prefix" 2>/dev/null || true
