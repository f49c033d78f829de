#!/usr/bin/env bash
# The Debian package, installed, used, updated, removed and purged on a system where systemd does not run.
#
# In: the package and its version (`make test-deb`); root. Out: a line for each thing that holds; exit code 1
# at the first that does not. All of it happens in a layer over this system's files that is in memory, with
# processes of its own: when the script ends, nothing is left of either. The libraries that the package needs
# have to be installed here, as they are where it was built.
set -euo pipefail

ADDRESS=127.88.3.1
FILTER=/etc/systemd/system/celld.service.d/address-filter.conf

outside() {
  if [ "$(id -u)" -ne 0 ]; then
    echo "SKIPPED: the package is not installed for a test, which needs root" >&2
    exit 0
  fi
  if ! grep -qw overlay /proc/filesystems && ! modprobe overlay 2>/dev/null; then
    echo "SKIPPED: the package is not installed for a test, this system has no overlay file system" >&2
    exit 0
  fi
  exec unshare --mount --pid --fork --kill-child --propagation private "$BASH" "$(realpath "$0")" layered \
    "$(realpath "$1")" "$2"
}

layered() {
  top=$(mktemp -d)
  trap 'cd /; umount -R --lazy "$top" 2>/dev/null || true; rmdir "$top"' EXIT
  mount -t tmpfs -o mode=755 tmpfs "$top"
  mkdir "$top/upper" "$top/work" "$top/root"
  mount -t overlay overlay -o "lowerdir=/,upperdir=$top/upper,workdir=$top/work" "$top/root"
  cd "$top/root"
  mount -t proc proc proc
  mount --rbind /dev dev
  mount -t tmpfs -o mode=755 tmpfs run
  mount -t tmpfs -o mode=1777 tmpfs tmp
  cp "$1" tmp/celld.deb
  cp "$0" tmp/package.sh
  chroot . /bin/bash /tmp/package.sh inside "$2"
}

holds() {
  local what=$1
  shift
  "$@" || { echo "FAILED: $what: $*" >&2; exit 1; }
  echo "ok: $what"
}

not() { ! "$@" 2>/dev/null; }
quietly() { "$@" >/dev/null 2>&1; }

# mode user:group path
has_mode() {
  local found
  found=$(stat -c '%a %U:%G' "$3")
  [ "$found" = "$1 $2" ] || { echo "$3: $found" >&2; return 1; }
}

# Words as a user, with the umask of that user's shell.
as() {
  local user=$1
  shift
  (cd /tmp && umask 0022 && setpriv --reuid="$user" --regid="$user" --init-groups -- "$@")
}

install_it() { dpkg --install /tmp/celld.deb >/tmp/dpkg.log 2>&1 || { cat /tmp/dpkg.log; return 1; }; }
says() { grep -q "$1" "$2"; }
answers() { for _ in $(seq 150); do "$@" >/dev/null 2>&1 && return; sleep 0.2; done; "$@"; }

inside() {
  dpkg --purge celld >/dev/null 2>&1 || true
  rm -rf /var/lib/celld /etc/celld
  installed "$1"
  shared
  running
  updated
  removed
}

installed() {
  holds "the package installs without systemd" install_it
  holds "every file is as it was packed" test -z "$(dpkg --verify celld)"
  holds "the state folder" has_mode 2750 celld:celld /var/lib/celld
  holds "job files" has_mode 2770 celld:celld /var/lib/celld/jobs/incoming
  holds "orders" has_mode 2770 celld:celld /var/lib/celld/commands
  holds "recordings" has_mode 2750 celld:celld /var/lib/celld/recordings
  holds "the configuration's folder" has_mode 2750 root:celld /etc/celld
  holds "the configuration" has_mode 640 root:celld /etc/celld/cell.yaml
  holds "groups for the camera" test "$(id -nG celld)" = "celld video plugdev"
  holds "the version" test "$(celld --version)" = "celld $1"
  holds "a manual page of every command" test -s /usr/share/man/man1/celld-plan.1
  holds "completions of bash" bash -c 'source /usr/share/bash-completion/completions/celld'
  holds "the simulator" quietly celld-sim --help
  holds "the reader of videos, with its libraries" test "$(celld-video --help 2>/dev/null; echo $?)" = 2
  holds "the first configuration is sound" quietly celld check /etc/celld/cell.yaml
  holds "the examples are sound" quietly celld check /usr/share/celld/examples/{cell,sim}.yaml
  holds "the address filter is that of the configuration" /usr/lib/celld/address-filter check
  # What set-up makes is what systemd-sysusers and systemd-tmpfiles would make.
  if command -v systemd-tmpfiles >/dev/null; then
    stat -c '%a %U:%G %n' /var/lib/celld /var/lib/celld/* /var/lib/celld/jobs/* >/tmp/before
    systemd-sysusers celld.conf
    systemd-tmpfiles --create celld.conf
    stat -c '%a %U:%G %n' /var/lib/celld /var/lib/celld/* /var/lib/celld/jobs/* >/tmp/after
    holds "sysusers.d and tmpfiles.d agree with set-up" cmp /tmp/before /tmp/after
  fi
}

shared() {
  useradd --groups celld member
  useradd other
  printf 'version: 1\ngoal: {objects: [{id: plank-1, pose: [0.25, 0.40, 0.0]}]}\n' >/tmp/job.yaml
  local incoming=/var/lib/celld/jobs/incoming
  holds "a member drops a job file" as member cp /tmp/job.yaml "$incoming/dropped.yaml"
  holds "it belongs to the group" has_mode 644 member:celld "$incoming/dropped.yaml"
  holds "a member hands a job in, without --state" quietly as member celld submit /tmp/job.yaml
  holds "another user does neither" not as other cp /tmp/job.yaml "$incoming/other.yaml"
  holds "nor sees the state" not as other ls /var/lib/celld
  holds "nor the configuration" not as other cat /etc/celld/cell.yaml
  holds "celld cannot change its configuration" not as celld touch /etc/celld/cell.yaml
  rm -f "$incoming"/*
}

# The daemon as the unit starts it, against the simulator.
running() {
  sed -i "s/127\.0\.0\.2/$ADDRESS/" /etc/celld/cell.yaml
  holds "an address that changed is noticed" not /usr/lib/celld/address-filter check
  holds "and let in" /usr/lib/celld/address-filter write
  holds "by number" says "IPAddressAllow=$ADDRESS" "$FILTER"
  holds "as it should be" /usr/lib/celld/address-filter check
  sed "s/127\.0\.0\.2/$ADDRESS/" /usr/share/celld/examples/sim.yaml >/tmp/sim.yaml
  celld sim --config /tmp/sim.yaml >/tmp/sim.log 2>&1 &
  (cd /var/lib/celld && umask 0027 && exec setpriv --reuid=celld --regid=celld --init-groups \
    celld run --config /etc/celld/cell.yaml --state /var/lib/celld) >/tmp/celld.log 2>&1 &
  daemon=$!
  holds "the cell is armed without --state" answers celld arm
  holds "the journal" has_mode 640 celld:celld /var/lib/celld/history.sqlite
  holds "a member reads the status" quietly as member celld status
  holds "and the list of jobs" quietly as member celld jobs
  holds "a member gives orders" quietly as member celld pause
  holds "another user does not read the journal" not as other cat /var/lib/celld/history.sqlite
  holds "celld stays while it is armed" not quietly dpkg --remove celld
}

updated() {
  echo "# measured here" >>/etc/celld/cell.yaml
  echo "CELLD_LOG=debug" >>/etc/celld/environment
  holds "an update raises no question" install_it </dev/null
  holds "and keeps the configuration" says "measured here" /etc/celld/cell.yaml
  holds "and the environment" says CELLD_LOG=debug /etc/celld/environment
  holds "celld still runs" kill -0 "$daemon"
  holds "disarmed" quietly celld disarm
  kill "$daemon"
  local code=0
  wait "$daemon" || code=$?
  holds "SIGTERM ends it well" test "$code" -eq 0
}

removed() {
  dpkg --remove celld >/dev/null 2>&1
  holds "removed, the configuration stays" test -e /etc/celld/cell.yaml
  dpkg --purge celld >/tmp/purge.log 2>&1
  holds "purged, it is gone" test ! -e /etc/celld
  holds "and so is the address filter" test ! -e "$FILTER"
  holds "the journal stays" test -e /var/lib/celld/history.sqlite
  holds "and is named" says "/var/lib/celld stays" /tmp/purge.log
  holds "installed again" install_it
  holds "the journal is there" test -s /var/lib/celld/history.sqlite
  rm -rf /var/lib/celld
  dpkg --purge celld >/dev/null 2>&1
  holds "without a journal, nothing is left" test ! -e /var/lib/celld
  holds "nor the account" not getent passwd celld
  local left
  left=$(find /usr/bin /usr/lib /usr/share/celld /usr/share/doc/celld /etc -name '*celld*' -newer /tmp/package.sh \
    -print -quit 2>/dev/null || true)
  holds "nor a file ($left)" test -z "$left"
}

case "${1:-}" in
  layered | inside) "$@" ;;
  '') echo "package.sh: give the package and its version" >&2; exit 2 ;;
  *) outside "$@" ;;
esac
