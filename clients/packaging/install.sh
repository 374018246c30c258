#!/bin/sh
# install.sh install|uninstall: installs or removes the files of the list beside this script, below
# $DESTDIR. The names between @ come from the environment.
set -eu
cd "$(dirname "$0")/../.."
action=$1
DESTDIR=${DESTDIR-}
# The folder below which those that become empty are removed: not in the system's own.
base=${DESTDIR:-$PREFIX}
case " $SYSTEM_PREFIXES " in *" $base "*) base=/nowhere ;; esac

# Copies standard input with the names between @ replaced.
fill() {
  sed -e "s|@BUILD@|$BUILD|g" -e "s|@VERSION@|$VERSION|g" -e "s|@SOVERSION@|$SOVERSION|g" \
    -e "s|@PREFIX@|$PREFIX|g" -e "s|@BINDIR@|$BINDIR|g" -e "s|@LIBDIR@|$LIBDIR|g" \
    -e "s|@INCLUDEDIR@|$INCLUDEDIR|g" -e "s|@MANDIR@|$MANDIR|g" -e "s|@DOCDIR@|$DOCDIR|g" -e "s|@UNITDIR@|$UNITDIR|g" \
    -e "s|@BASHDIR@|$BASHDIR|g" -e "s|@ZSHDIR@|$ZSHDIR|g" -e "s|@PYTHONDIR@|$PYTHONDIR|g" -e "s|@TLS_LIBS@|$TLS_LIBS|g"
}

put() { # mode, source, path
  mkdir -p "${3%/*}"
  case $1 in
  link) ln -sfn "$2" "$3" ;;
  fill)
    fill <"$2" | sed -e '/^#@/d' -e 's/ *#!$//' >"$3"
    chmod 644 "$3"
    ;;
  each)
    fill <"$2" | sed -e '/#!$/d' -e 's/^#@ *//' >"$3"
    chmod 644 "$3"
    ;;
  *) install -m "$1" "$2" "$3" ;;
  esac
}

# Removes a file, with a Python module what Python has compiled from it, and the folders that become
# empty, if they are below the base or named after the project.
take_away() { # path
  rm -f "$1"
  left=${1%/*}
  case $1 in
  *.py)
    rm -rf "$left/__pycache__"
    rmdir "$left" 2>/dev/null || true
    ;;
  esac
  while :; do
    case $left in "$base"/* | "$PREFIX"/*dipole*) ;; *) break ;; esac
    rmdir "$left" 2>/dev/null || [ ! -d "$left" ] || break
    left=${left%/*}
  done
}

# A path may contain blanks, but no line ends.
newline='
'
grep -v '^#' clients/packaging/files | fill | while read -r mode source place; do
  case $place in
  */) name=${source##*/} ;;
  *) name=${place##*/} ;;
  esac
  folder=$DESTDIR${place%/*}
  IFS=$newline
  case $action in
  install)
    for one in $source; do
      case $name in
      *\**) put "$mode" "$one" "$folder/${one##*/}" ;;
      *) put "$mode" "$one" "$folder/$name" ;;
      esac
    done
    ;;
  uninstall)
    for one in $folder/$name; do
      take_away "$one"
    done
    ;;
  esac
  unset IFS
done
[ "$action" = install ] || [ "$base" = /nowhere ] || [ -n "$DESTDIR" ] || rmdir "$base" 2>/dev/null || true
