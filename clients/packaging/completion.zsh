#compdef dipole dipoled
# Completes the command lines of dipole and dipoled in zsh. Commands, options and the names that a
# help text lists come from --help of the program; the names in a daemon's lists come from
# `dipole info` and `dipole media`, which start a private daemon for the time of the question.

# Adds the names that an option's value may have. abouts holds what help says about each option.
_dipole_names() { # OPTION many|one
  local option=$1 about=$abouts[$1] many=$2 list
  local -a names
  case $option in
  model | fit-model) list=models ;;
  evaluator | moments | phase | scale | light | coefficients) list=${option%s}s ;;
  wanted | quantity) list=quantities ;;
  draw) list=draws ;;
  medium) names=(${(fu)"$($program[1] media --connect private: --format csv | sed 1d | cut -d, -f1)"}) ;;
  esac
  [[ -n $list ]] &&
    names=(${(f)"$($program[1] info --connect private: --format csv | sed -n "s/^$list,\([^,]*\),.*/\1/p")"})
  if (( ! $#names )); then
    local word='[[:alnum:]_-]+'
    if [[ $about =~ "^(one of )($word(,$word)*)( |\$)" ||
      $about =~ "^(.*: )?(($word, )*$word or $word)(\.|\$)" ||
      $about =~ "^(.*: )?(($word, )+$word)(\.|\$)" ]]; then
      names=(${(s: :)${${match[2]// or / }//,/ }})
    fi
  fi
  (( $#names )) || return
  [[ $about == *'all: '* ]] && names=(all $names)
  if [[ $many == many ]]; then
    _values -s , $option $names
  else
    compadd -a names
  fi
}

_dipole_address() {
  if compset -P unix:; then
    _files
  else
    compadd -S '' unix: tcp: private:
  fi
}

_dipole() {
  local line about action repeated many optional operand='*: :'
  local -a program=($words[1]) specs match mbegin mend
  local -A abouts
  if [[ ${program[1]:t} == dipole ]]; then
    if (( CURRENT == 2 )) || [[ $words[2] == help ]]; then
      local -a commands=(${(f)"$($program --help | sed -n '/^Commands/,/^$/s/^  \([a-z]*\)  *\(.*\)/\1:\2/p')"})
      _describe -t commands command commands
      return
    fi
    program+=$words[2]
    shift words
    (( CURRENT-- ))
    [[ $($program --help) =~ $'^Usage:[^\n]*FILE\]' ]] && operand='*:file:_files'
  fi
  # Each option with its explanation on one line, then each line as a specification for _arguments.
  $program --help | awk '/^  --/ { printf "%s%s", sep, $0; sep = "\n"; inside = 1; next }
    /^     / && inside { sub(/^ +/, " "); printf "%s", $0; next } { inside = 0 } END { print "" }' |
    while read -r line; do
      [[ $line =~ '^--([a-z-]+)( ([A-Z[][^ ]*))?( +(.*))?$' ]] || continue
      about=$match[5] abouts[$match[1]]=$match[5] repeated='' many=one optional=:
      [[ $about == *'may be repeated'* ]] && repeated='*'
      [[ $match[3] == *...* ]] && many=many
      [[ $match[3] == '['* ]] && optional=::
      case $match[3] in
      *FILE*) action=_files ;;
      ADDRESS | URL) action=_dipole_address ;;
      *) action=" _dipole_names $match[1] $many" ;;
      esac
      line="$repeated--$match[1]${match[3]:+=}[${${${about%%[;.(]*}//[\[\]]/}//:/ }]"
      specs+=("$line${match[3]:+$optional${match[3]//[^A-Z]/ }:$action}")
    done
  _arguments $specs $operand
}

_dipole "$@"
