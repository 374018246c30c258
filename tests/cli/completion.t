## Completion of command lines by bash, as a user gets it. lists.t has what `dipole complete` offers.
$ echo 'source "$REPOSITORY/clients/packaging/completion.bash"; COMP_LINE=$1; COMP_POINT=${#1}; COMP_WORDBREAKS=$2; COMP_WORDS=(${1%% *}); _dipole 2> /dev/null; printf "%s\n" "${COMPREPLY[@]}"' > driver; bash -c 'source $REPOSITORY/clients/packaging/completion.bash && complete -p dipole dipoled'
complete -o default -F _dipole dipole
complete -o default -F _dipole dipoled

## Every command and option of the help.
$ options() { "$@" --help | sed -n 's/^  \(--[a-z-]*\).*/\1/p'; }; bash driver 'dipole ' > commands; dipole --help | sed -n 's/^  \([a-z]*\)  *[A-Z].*/\1/p' | diff - commands; for command in $(grep -v help commands); do options dipole $command > listed; bash driver "dipole $command --" | diff listed - && echo $command $(grep -c . listed); done; options dipoled > listed; bash driver 'dipoled --' | diff listed - && wc -l < listed
eval 47
plot 48
points 28
sample 43
invert 22
fit 28
texture 27
convert 21
bake 26
gather 25
table 36
mc 35
tissue 13
media 8
info 8
bench 40
49

## Readline cuts words at = and :, unless a user has changed that.
$ cut=$(printf ' \t\n"'"'"'><=;|&(:'); for line in 'dipole eval --medium skin' 'dipole eval --medium=skin' 'dipole eval --wanted R,al' 'dipole info --connect t' 'dipole points '; do for breaks in "$cut" "$(printf ' \t')"; do echo "$line:" $(bash driver "$line" "$breaks"); done; done
dipole eval --medium skin: skin-dark skin-light skin-medium skin1 skin2
dipole eval --medium skin: skin-dark skin-light skin-medium skin1 skin2
dipole eval --medium=skin: skin-dark skin-light skin-medium skin1 skin2
dipole eval --medium=skin: --medium=skin-dark --medium=skin-light --medium=skin-medium --medium=skin1 --medium=skin2
dipole eval --wanted R,al: R,albedo
dipole eval --wanted R,al: R,albedo
dipole info --connect t: tcp: tls:
dipole info --connect t: tcp: tls:
dipole points :
dipole points :
