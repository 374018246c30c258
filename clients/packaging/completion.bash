# Completes the command lines of dipole and dipoled in bash. Commands, options and the names that a
# help text lists come from --help of the program; the names in a daemon's lists come from
# `dipole info` and `dipole media`, which start a private daemon for the time of the question.

# Prints each option that `PROGRAM [COMMAND] --help` describes, with its explanation, on one line.
_dipole_options() { # PROGRAM [COMMAND]
  "$@" --help 2>/dev/null | awk '
    /^  --/ { printf "%s%s", sep, $0; sep = "\n"; inside = 1; next }
    /^     / && inside { sub(/^ +/, " "); printf "%s", $0; next }
    { inside = 0 }'
}

_dipole_commands() { # PROGRAM
  "$1" --help 2>/dev/null | awk '/^Commands/ { inside = 1; next } !NF { inside = 0 } inside { print $1 }'
}

# Prints the names that a daemon has for an option's value.
_dipole_daemon_names() { # PROGRAM OPTION
  local list
  case $2 in
  --model | --fit-model) list=models ;;
  --evaluator) list=evaluators ;;
  --moments) list=moments ;;
  --phase) list=phases ;;
  --scale) list=scales ;;
  --light) list=lights ;;
  --coefficients) list=coefficients ;;
  --wanted | --quantity) list=quantities ;;
  --draw) list=draws ;;
  --medium)
    "$1" media --connect private: --format csv 2>/dev/null | awk -F, 'NR > 1 && !seen[$1]++ { print $1 }'
    return
    ;;
  *) return ;;
  esac
  "$1" info --connect private: --format csv 2>/dev/null | awk -F, -v list=$list '$1 == list { print $2 }'
}

# Sets what the value of an option may be: kind (names, file, address, unknown, or nothing when the
# option has no value), names, many (several names with commas between them), optional.
_dipole_value() { # OPTION PROGRAM [COMMAND]
  local option=$1 line value about
  kind='' names='' many='' optional=''
  shift
  line=$(_dipole_options "$@" | grep -m1 -E -- "^  $option( |\$)")
  [[ $line =~ ^\ \ [^\ ]+(\ ([A-Z\[][^\ ]*))?(\ +(.*))?$ ]]
  value=${BASH_REMATCH[2]} about=${BASH_REMATCH[4]}
  [[ $value ]] || return
  kind=unknown
  [[ $value == *...* ]] && many=yes
  [[ $value == \[* ]] && optional=yes
  case $value in
  *FILE*) kind=file ;;
  ADDRESS | URL)
    kind=address
    names=$(grep -oE '(unix|tcp|private):' <<<"$about" | awk '!seen[$0]++')
    ;;
  *)
    local word='[[:alnum:]_-]+'
    names=$(_dipole_daemon_names "$1" "$option")
    if [[ ! $names && $about =~ ^(one of )($word(,$word)*)( |$) ||
      ! $names && $about =~ ^(.*: )?(($word, )*$word or $word)(\.|$) ||
      ! $names && $about =~ ^(.*: )?(($word, )+$word)(\.|$) ]]; then
      names=${BASH_REMATCH[2]}
      names=${names// or / }
      names=${names//,/ }
    fi
    [[ $names && $about == *'all: '* ]] && names="all $names"
    [[ $names ]] && kind=names
    ;;
  esac
}

# Fills COMPREPLY with what the value may become.
_dipole_complete_value() { # VALUE
  local value=$1 head='' IFS=$' \t\n'
  case $kind in
  file)
    compopt -o filenames 2>/dev/null
    mapfile -t COMPREPLY < <(compgen -f -- "$value")
    ;;
  address)
    compopt -o nospace 2>/dev/null
    if [[ $value == unix:* ]]; then
      compopt -o filenames 2>/dev/null
      mapfile -t COMPREPLY < <(compgen -P unix: -f -- "${value#unix:}")
    else
      mapfile -t COMPREPLY < <(compgen -W "$names" -- "$value")
    fi
    ;;
  names)
    if [[ $many ]]; then
      compopt -o nospace 2>/dev/null
      [[ $value == *,* ]] && head=${value%,*},
    fi
    mapfile -t COMPREPLY < <(compgen -P "$head" -W "$names" -- "${value#"$head"}")
    ;;
  esac
}

# Sets words, the words before the cursor, and current, the last of them. Readline also cuts at = and
# :, which options and addresses contain; here they stay whole.
_dipole_words() {
  local rest=${COMP_LINE:0:COMP_POINT} i word
  words=()
  for ((i = 0; i < COMP_CWORD; i++)); do
    word=${COMP_WORDS[i]}
    if ((i > 0)) && [[ $rest != [[:space:]]* ]]; then
      words[-1]+=$word
    else
      words+=("$word")
    fi
    rest=${rest#"${rest%%[![:space:]]*}"}
    rest=${rest#"$word"}
  done
  if [[ $rest == [[:space:]]* ]]; then
    current=${rest#"${rest%%[![:space:]]*}"}
  else
    current=${words[-1]}$rest
    unset 'words[-1]'
  fi
}

# Sets kind and names for a word that follows no option: the operand, or else the next option.
_dipole_operand() {
  kind=names many=''
  if [[ ${program[0]##*/} == dipole ]] && ((${#words[@]} == 1)) || [[ ${program[1]-} == help ]]; then
    names=$(_dipole_commands "${words[0]}")
  elif [[ $current != -* && $("${program[@]}" --help 2>/dev/null) =~ ^Usage:[^$'\n']*FILE\] ]]; then
    kind=file
  else
    names=$(_dipole_options "${program[@]}" | awk '{ print $1 }')
  fi
}

_dipole() {
  local current kind names many optional option=''
  local -a words program
  COMPREPLY=()
  _dipole_words
  program=("${words[0]}")
  [[ ${words[0]##*/} == dipole && ${words[1]-} ]] && program+=("${words[1]}")
  if [[ $current == --*=* ]]; then
    option=${current%%=*}
    current=${current#*=}
    _dipole_value "$option" "${program[@]}"
    _dipole_complete_value "$current"
    [[ $COMP_WORDBREAKS == *=* ]] || COMPREPLY=("${COMPREPLY[@]/#/$option=}")
  else
    [[ ${words[-1]} == --* ]] && _dipole_value "${words[-1]}" "${program[@]}"
    [[ ! $kind || ($optional && $current == --*) ]] && _dipole_operand
    _dipole_complete_value "$current"
  fi
  if [[ $current == *:* && $COMP_WORDBREAKS == *:* ]]; then
    COMPREPLY=("${COMPREPLY[@]#"${current%"${current##*:}"}"}")
  fi
}

complete -F _dipole dipole dipoled
