# Completes the command lines of dipole and dipoled in bash. `dipole complete LINE` says what the last
# word of a line may become; where it says nothing, bash completes names of files. dipoled has options
# alone, which come from its --help.

_dipole() {
  local line=${COMP_LINE:0:COMP_POINT} current kept
  current=${line##*[[:space:]]}
  if [[ ${COMP_WORDS[0]##*/} == dipoled ]]; then
    mapfile -t COMPREPLY < <(compgen -W "$("${COMP_WORDS[0]}" --help | grep -oE '^  --[a-z-]+')" -- "$current")
    return
  fi
  mapfile -t COMPREPLY < <("${COMP_WORDS[0]}" complete "$line" 2>/dev/null | cut -f 1)
  # Readline replaces what stands behind the last = or : where these cut words.
  [[ $current == *[=:]* ]] && kept=${current%"${current##*[${COMP_WORDBREAKS//[^=:]/}]}"}
  COMPREPLY=("${COMPREPLY[@]#"$kept"}")
  [[ ${COMPREPLY[0]-} == *: || $current == *,* ]] && compopt -o nospace 2>/dev/null
  return 0
}

complete -o default -F _dipole dipole dipoled
