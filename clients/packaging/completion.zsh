#compdef dipole dipoled
# Completes the command lines of dipole and dipoled in zsh. `dipole complete LINE` says what the last
# word of a line may become, with an explanation behind a tab; where it says nothing, zsh completes
# names of files. dipoled has options alone, which come from its --help.

_dipole() {
  local -a found
  if [[ ${words[1]:t} == dipoled ]]; then
    found=(${(f)"$($words[1] --help | grep -oE '^  --[a-z-]+' | tr -d ' ')"})
  else
    found=(${(f)"$($words[1] complete "${(j: :)words[1,CURRENT]}" | sed 's/:/\\:/g; s/\t/:/')"})
  fi
  if (( $#found )); then
    _describe -t values value found
  else
    _files
  fi
}

_dipole "$@"
