#!/bin/sh
# Is this program what anyone can copy anywhere? Statically linked, stripped, and not too large. In: the
# program, and the most megabytes (10^6 bytes) it may have. Out: a line; exit code 1 says what it is not.
set -eu
program=$1 most=$2
fail() { echo "static: $program: $1" >&2; exit 1; }
headers=$(LC_ALL=C readelf --wide --program-headers --section-headers --dynamic "$program") || fail "not an ELF file"
case $headers in *"(NEEDED)"*) fail "it needs shared libraries: $(echo "$headers" | grep -F '(NEEDED)')" ;; esac
case $headers in *INTERP*) fail "it needs a program interpreter" ;; esac
case $headers in *.symtab*|*.debug_*) fail "it is not stripped" ;; esac
bytes=$(stat -c %s "$program")
[ "$bytes" -le $((most * 1000000)) ] || fail "$bytes bytes, more than $most MB"
echo "static: $program: $bytes bytes, no library needed"
