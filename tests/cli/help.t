## Help, versions, and wrong command lines.
$ dipole help --help | head -n 1; dipole invert --help > /dev/full
Usage: dipole COMMAND [OPTION]...
! dipole: cannot write the output: No space left on device
? 1

$ dipole --version
dipole 0.1.0

$ dipole help
Usage: dipole COMMAND [OPTION]...

Queries the daemon dipoled: how much light leaves a translucent medium at distance r from
where it entered: R(r) in 1/mm^2 per unit of power that entered. Unless --connect
or the environment variable DIPOLED names a daemon, it starts a private one.

Commands
  eval     Evaluate a medium over a range of radii, as a table or a picture
  plot     Draw profiles over r, and how far they are from radiative transport
  points   Evaluate each row of a CSV file (or of standard input)
  sample   Draw radii in proportion to the light that leaves there
  invert   Find the medium that has a given albedo: sigma_a and sigma_s
  fit      Find sigma_a and sigma_s' of samples from readings of their reflectance
  texture  Map an image of colours to images of the media that have them
  convert  Convert colours and lengths between renderers, and to coefficients
  bake     Bake kernels, lengths and tables of a medium for engines, with their errors
  gather   Sum the light that points leave at other positions
  table    Fetch tables of a medium, to be evaluated without a daemon
  mc       Walk photons through a medium (Monte Carlo): R(r) with standard errors
  tissue   Show the coefficients of a tissue at wavelengths, or list tissues
  media    List the media with names: their coefficients, or layers
  info     Show a daemon: models, evaluators, instruction set, limits, statistics
  bench    Measure how fast a daemon replies: latency, pipelined requests, throughput
  help     This text, or `dipole help COMMAND`

`dipole COMMAND --help` describes a command; `dipole --version` prints the version.

$ dipole help evaluate
! dipole: there is no command 'evaluate'; the commands are eval, plot, points, sample, invert, fit, texture, convert, bake, gather, table, mc, tissue, media, info, bench, help
? 2

$ dipole evaluate
! dipole: there is no command 'evaluate'; the commands are eval, plot, points, sample, invert, fit, texture, convert, bake, gather, table, mc, tissue, media, info, bench, help
? 2

$ dipole invert --help
Usage: dipole invert [OPTION]... [FILE]

Find the medium that has a given albedo: sigma_a and sigma_s.

Takes a diffuse albedo and a length, and finds the coefficients of a medium that has them by a
model. sigma_t' is sigma_a + sigma_s (1 - g). The errors of coefficients are the most by which
they are off the model's exact formula; the model error is how far the albedo is from radiative
transport's, relative. The exit status is 3 if there is no such medium for some channel.

FILE is CSV with the columns albedo and mean_free_path (or another length; as the options, with _
for -); - is standard input. Each row is a channel. For images, see `dipole texture`. CSV has a
header, and commas, semicolons or tabs between its cells. Lines that start with # are comments,
but below the header only those with one cell.

Medium
  --albedo X[,X...]     diffuse albedo: the share that leaves of the power that entered, 0 to 1,
                        linear; one value for each channel
  --srgb                the albedos are sRGB values, 0 to 1
  --light NAME          the light of the colours: beam, at normal incidence, or diffuse, the same
                        from all directions (default: beam)
  --specular            the colours contain what the surface itself reflects (Fresnel)
  --mean-free-path X[,X...]
                        1 / sigma_t'; a single value is for all channels
  --diffuse-mean-free-path X[,X...]
                        instead: 1 / (sigma_t' sqrt(3 a / (1 + a))), a = sigma_a / sigma_t'
  --classical-diffuse-path X[,X...]
                        instead: 1 / sqrt(3 sigma_a sigma_t')
  --extinction-path X[,X...]
                        instead: 1 / (sigma_a + sigma_s), which most renderers mean
  --unit NAME           unit of lengths: mm (default), cm, m, or the millimetres of a scene's unit
  --g X                 mean cosine of the scattering angle (default: 0)
  --eta X               refractive index inside over outside; 1: no interface (default: 1.3)

Evaluation
  --model NAME          the model that gives the albedo; see `dipole info`. transport takes some 5
                        ms for each medium, better microseconds (default: transport)
  --moments NAME        Fresnel moments; `dipole info` lists them (default: exact)
  --deadline-ms N       the daemon replies within N ms or refuses; 0: no limit

Options of all commands
  --connect ADDRESS     unix:PATH, tcp:HOST:PORT or tls:HOST:PORT; private: starts a private
                        daemon. Several, separated by commas, are tried in turn (default: the
                        environment variable DIPOLED, else private:; for info and bench the
                        installed service before that, if it is there)
  --ca FILE             for tls: the certificates that sign the daemon's, PEM (default: the
                        environment variable DIPOLED_CA, else those of the system)
  --certificate FILE    for tls: the client's certificate, PEM, if the daemon requires one
                        (default: the environment variable DIPOLED_CERTIFICATE)
  --key FILE            for tls: its key (default: the environment variable DIPOLED_KEY, else in
                        the file of the certificate)
  --format FORMAT       one of table,csv,json (default: table)
  --timeout-ms N        give up if the daemon is silent for N ms; 0: never (default: 30000)
  --retry-ms N          retry for N ms if no daemon replies, or if it is lost or busy; 0: do not
                        retry (default: 5000; while it is busy: --timeout-ms, if that is more)
  --help                print this text

Exit status: 0 done, 1 failed, 2 wrong command line, 3 some rows or values are bad
(points, invert, texture, fit).

Examples
  dipole invert --albedo 0.44,0.22,0.13 --mean-free-path 1.3,0.95,0.67
  dipole invert colours.csv --format csv | dipole points --r 1 > with_R.csv
  dipole invert --albedo 0.8 --diffuse-mean-free-path 2 --g 0.9 --eta 1.4
  dipole invert --albedo 0.8,0.5,0.2 --srgb --extinction-path 1 --light diffuse --model transport
  dipole invert --albedo 0.1,0.5,0.9 --mean-free-path 1 --model classical --format csv
  dipole invert --albedo 0.8 --mean-free-path 1 --model quantized --format json

$ dipole eval
! dipole eval: give --medium NAME, or --sigma-a and --sigma-s, or --layer
! `dipole eval --help` says more.
? 2

$ dipole eval --sigma-a 1
! dipole eval: give --medium NAME, or --sigma-a and --sigma-s, or --layer
! `dipole eval --help` says more.
? 2

$ dipole eval skin1
! dipole eval: 'skin1' is one argument too many: leave it out
! `dipole eval --help` says more.
? 2

$ dipole points a.csv b.csv
! dipole points: 'b.csv' is one argument too many: leave it out
! `dipole points --help` says more.
? 2

$ dipole media --mediun
! dipole media: --mediun: no such option
! `dipole media --help` says more.
? 2

$ dipole media -x
! dipole media: -x: no such option
! `dipole media --help` says more.
? 2

$ for one in '--meduim=skin1' '--sigma-a 0.1 --sigma-s 1 --model bettr' '--sigma-a'; do dipole eval $one || echo $?; done
2
2
2
! dipole eval: --meduim=skin1: no such option; the nearest is --medium
! `dipole eval --help` says more.
! dipole eval: --model: 'bettr' is unknown; this daemon has classical, better, grosjean, boundary, exitance, grosjean-boundary, grosjean-exitance, boundary-exitance, extended, quantized, beam, single, classical+single, better+single, extended+single, quantized+single, beam+single, burley, burley-diffuse, burley-dmfp, skin-red, skin-green, skin-blue, gaussians, multipole, multipole-transmitted, better-multipole, better-multipole-transmitted, transport, transport-transmitted. Is it better?
! `dipole eval --help` says more.
! dipole eval: --sigma-a: a value is missing
! `dipole eval --help` says more.

$ dipole media --format xml
! dipole media: --format xml: one of table,csv,json (default: table)
! `dipole media --help` says more.
? 2

$ dipole media --format able
! dipole media: --format able: one of table,csv,json (default: table)
! `dipole media --help` says more.
? 2

$ dipole points --format json
! dipole points: --format json: only csv
! `dipole points --help` says more.
? 2

$ dipole media --timeout-ms -1
! dipole media: --timeout-ms: '-1' is no whole number
! `dipole media --help` says more.
? 2

$ dipole media --timeout-ms 4294967296
! dipole media: --timeout-ms: '4294967296' is no whole number up to 4294967295
! `dipole media --help` says more.
? 2

$ dipole media --retry-ms 4294967296
! dipole media: --retry-ms: '4294967296' is no whole number up to 4294967295
! `dipole media --help` says more.
? 2

$ dipole media --retry-ms soon
! dipole media: --retry-ms: 'soon' is no whole number
! `dipole media --help` says more.
? 2

$ for one in '--sigma-a 0.1 --sigma-s 1 --g 0x1p-1' '--sigma-a 0.1 --sigma-s 1 --g 0,5,' '--sigma-a 0,05' '--sigma-a 0.1 --sigma-s 1 --r 1,-00.5'; do dipole eval $one || echo $?; done
2
2
2
2
! dipole eval: --g: '0x1p-1' is no decimal number
! `dipole eval --help` says more.
! dipole eval: --g: '0,5,' is no list of decimal numbers up to 1.8e308
! `dipole eval --help` says more.
! dipole eval: --sigma-a: '0,05' is no list of numbers: one of them starts with a 0; write a decimal point, as in 0.05
! `dipole eval --help` says more.
! dipole eval: --r: '1,-00.5' is no list of numbers: one of them starts with a 0; write a decimal point, as in 0.05
! `dipole eval --help` says more.

$ dipole invert --albedo 07
! dipole invert: --albedo: '07' is no list of numbers: one of them starts with a 0; write a decimal point, as in 0.05
! `dipole invert --help` says more.
? 2

$ dipole invert --eta 1,4
! dipole invert: --eta: '1,4' is no number: write a decimal point, as in 0.05
! `dipole invert --help` says more.
? 2

$ dipole eval --sigma-a 0.1 --sigma-s 1 --g ' 0'
! dipole eval: --g: ' 0' is no decimal number
! `dipole eval --help` says more.
? 2

$ for one in '--sigma-a 0.1 --sigma-s 1 --eta 1e999' '--sigma-a 0.1 --sigma-s 1 --to 1mm' '--sigma-a 0.1 --sigma-s 1 --count 1e3' '--sigma-a 0.1 --sigma-s 1 --count 18446744073709551616' '--sigma-a 0.1 --sigma-s 1 --medium skin1' '--sigma-a 0.1 --sigma-s 1 --r 1 --count 3' '--sigma-a 0.1 --sigma-s 1 --log' '--sigma-a 0.1 --sigma-s 1 --g 0,0.5 --eta 1,1.2,1.4' '--medium skin1 --eta 1,2' '--sigma-a 0.1 --sigma-s 1 --deadline-ms 4294967296' '--sigma-a 0.1 --sigma-s 1 --deadline-ms -1' '--sigma-a 0.1 --sigma-s 1 --plot r.pdf' '--sigma-a 0.1 --sigma-s 1 --plot .png' '--sigma-a 0.1 --sigma-s 1 --plot r.png --wanted albedo' '--sigma-a 0.1 --sigma-s 1 --plot - --format json' '--sigma-a 0.1 --sigma-s 1 --model better,' '--sigma-a 0.1 --sigma-s 1 --moments fat' '--sigma-a 0.1 --sigma-s 1 --evaluator f16' '--sigma-a 0.1 --sigma-s 1 --wanted colour' '--medium skin'; do dipole eval $one || echo $?; done
2
2
2
2
2
2
2
2
2
2
2
2
2
2
2
2
2
2
2
2
! dipole eval: --eta: '1e999' is no number up to 1.8e308
! `dipole eval --help` says more.
! dipole eval: --to: '1mm' is no decimal number
! `dipole eval --help` says more.
! dipole eval: --count: '1e3' is no whole number
! `dipole eval --help` says more.
! dipole eval: --count: '18446744073709551616' is no whole number
! `dipole eval --help` says more.
! dipole eval: --medium NAME stands for --sigma-a and --sigma-s: leave these out; --g and --eta may stay
! `dipole eval --help` says more.
! dipole eval: --r gives the radii one by one: leave --from, --to, --count and --log out
! `dipole eval --help` says more.
! dipole eval: --log needs --from, above 0
! `dipole eval --help` says more.
! dipole eval: --eta has 3 values and --g has 2: give one value or as many
! `dipole eval --help` says more.
! dipole eval: --eta has 2 values and --medium has 3: give one value or as many
! `dipole eval --help` says more.
! dipole eval: --deadline-ms: '4294967296' is no whole number up to 4294967295
! `dipole eval --help` says more.
! dipole eval: --deadline-ms: '-1' is no whole number
! `dipole eval --help` says more.
! dipole eval: --plot r.pdf: the name must end in .svg or .png; - is the terminal
! `dipole eval --help` says more.
! dipole eval: --plot .png: the name must end in .svg or .png; - is the terminal
! `dipole eval --help` says more.
! dipole eval: --plot draws R: add R to --wanted
! `dipole eval --help` says more.
! dipole eval: --plot - draws onto standard output, where the json goes: name a file, or leave --format out
! `dipole eval --help` says more.
! dipole eval: --model: '' is unknown; this daemon has classical, better, grosjean, boundary, exitance, grosjean-boundary, grosjean-exitance, boundary-exitance, extended, quantized, beam, single, classical+single, better+single, extended+single, quantized+single, beam+single, burley, burley-diffuse, burley-dmfp, skin-red, skin-green, skin-blue, gaussians, multipole, multipole-transmitted, better-multipole, better-multipole-transmitted, transport, transport-transmitted
! `dipole eval --help` says more.
! dipole eval: --moments: 'fat' is unknown; this daemon has exact, fit, jensen, pbrt. Is it fit?
! `dipole eval --help` says more.
! dipole eval: --evaluator: 'f16' is unknown; this daemon has f64, f32, lut
! `dipole eval --help` says more.
! dipole eval: --wanted: 'colour' is unknown; this daemon has R, albedo, cdf, r, ...
! `dipole eval --help` says more.
! dipole eval: --medium: 'skin' is unknown; this daemon has apple, chicken1, chicken2, cream, ketchup, marble, potato, skimmilk, skin-dark, skin-light, skin-medium, skin1, skin2, spectralon, wholemilk
! `dipole eval --help` says more.

$ dipole points --evaluator f16
! dipole points: --evaluator: 'f16' is unknown; this daemon has f64, f32, lut
! `dipole points --help` says more.
? 2

## What the daemon refuses, and daemons that are not there.
$ for one in '--sigma-a -1 --sigma-s 1' '--sigma-a inf --sigma-s 1' '--sigma-a 1 --sigma-s nan' '--sigma-a 0,-1 --sigma-s 1' '--sigma-a 0.1 --sigma-s 1 --g 1' '--sigma-a 0.1 --sigma-s 1 --eta 0' '--sigma-a 0.1 --sigma-s 1 --r 0,-1' '--sigma-a 0.1 --sigma-s 1 --from -1' '--sigma-a 0.1 --sigma-s 1 --from 0 --log' '--sigma-a 0.1 --sigma-s 1 --to inf' '--sigma-a 0.1 --sigma-s 1 --count 99999999999999' '--sigma-a 0.1 --sigma-s 1 --tolerance 1e-9' '--sigma-a 0.1 --sigma-s 1 --model better,multipole' '--sigma-a 0.1 --sigma-s 1 --model multipole,better --thickness 9'; do dipole eval $one || echo $?; done
1
1
1
1
1
1
1
1
1
1
1
1
1
1
! dipole eval: bad-value: sigma_a: allowed: 0 to 1e15 per mm (--sigma-a)
! dipole eval: bad-value: sigma_a: allowed: 0 to 1e15 per mm (--sigma-a)
! dipole eval: bad-value: sigma_s: allowed: 0 to 1e15 per mm (--sigma-s)
! dipole eval: bad-value: sigma_a of medium 2 of 2: allowed: 0 to 1e15 per mm (--sigma-a)
! dipole eval: bad-value: g: allowed: between -1 and 1, exclusive (--g)
! dipole eval: bad-value: eta: allowed: 0.001 to 1000 (--eta)
! dipole eval: bad-value: r number 2 of 2: allowed: 0 to infinity, in mm (--r)
! dipole eval: bad-value: radius_start: allowed: at least 0 mm, finite (--from)
! dipole eval: bad-value: radius_start: allowed: at least 1e-300 mm, finite (logarithmic) (--from)
! dipole eval: bad-value: radius_stop: allowed: at least radius_start, finite (--to)
! dipole eval: too-large: radius_count: allowed: at most 1099511627776 radii (--count)
! dipole eval: bad-value: tolerance: allowed: at least 3.22e-06 (best: transport, f64) (--tolerance)
! dipole eval: model multipole: bad-value: thickness: allowed: above 0 mm: this model is of a slab (--thickness)
! dipole eval: model better: bad-value: thickness: allowed: 0, a half space, with this model: transport and multipoles take slabs (--thickness)

$ dipole media --connect localhost
! dipole media: address 'localhost': write unix:PATH, tcp:HOST:PORT, tls:HOST:PORT or private:
? 1

$ dipole media --connect unix:/nonexistent/d --retry-ms 0
! dipole media: cannot connect to the socket /nonexistent/d: No such file or directory
! The address is from --connect. If no daemon runs there, start one with `dipoled --listen unix:/nonexistent/d`. Or leave --connect out: dipole then starts a daemon for itself.
? 1

$ DIPOLED=unix:/nonexistent/d dipole media --retry-ms 0
! dipole media: cannot connect to the socket /nonexistent/d: No such file or directory
! The address is from the environment variable DIPOLED. If no daemon runs there, start one with `dipoled --listen unix:/nonexistent/d`. Or unset that variable: dipole then starts a daemon for itself.
? 1

## The help of a command lists what it takes.
$ for command in eval fit texture; do echo "$command: $(dipole $command --help | grep -oE '^  --(cos-in|thickness|gaussians|fit-model|tolerance) ' | tr -d '\n')"; done
eval:   --thickness   --tolerance   --cos-in   --gaussians   --fit-model 
fit:   --thickness   --tolerance 
texture:   --tolerance 

$ dipole eval --help | grep -A 1 -e '--fit-model'
  --fit-model NAME      model to fit; else better
  --fit-from X          mm: least radius of a fit; else 0.1 mfp (0 to 1e30)

$ dipole mc --help | grep -A 1 -e '--phase NAME'
  --phase NAME          of mc: phase function; else henyey-greenstein
  --phase-share X       of mc with phase modified or two-term: share of the first HG (1e-6 to 1)

$ for command in eval points texture; do dipole $command --help | grep -e '^  --format'; done
  --format FORMAT       one of table,csv,json (default: table)
  --format FORMAT       only csv
  --format FORMAT       only none, as images are written

$ dipole plot --format csv
! dipole plot: --format csv: only none, as images are written
! `dipole plot --help` says more.
? 2

$ cp "$(command -v dipole)" . && mkdir dipoled && ./dipole info --connect private: | head -n 1 && rmdir dipoled && rm dipole
section         name                                value

$ dipole media --connect private:/nonexistent
! dipole media: cannot start a private daemon: there is no program /nonexistent beside this program or in PATH. Install dipoled, or name a running daemon, as in DIPOLED=tcp:HOST:PORT
? 1

## The help of each command has its use, examples, the exit status and the options of all, in 100 columns.
$ mkdir help; cd help; for one in eval plot points sample invert fit texture table mc media info top bench; do dipole $one --help > $one; sed '1,/^Examples$/d' $one | grep -o -m 1 "^  dipole $one" | cut -c 1-8; done > ../uses; awk 'length > 100' *; (head -qn 1 * | grep -o '^Usage: dipole '; cat ../uses * | grep -o -e '^  dipole$' -e 'Exit status: 0 ' -e '^  --connect ADDRESS' -e '^  --format FORMAT' -e '^  --timeout-ms N' -e '^  --retry-ms N' -e '^  --help') | sort | uniq -c; dipole help mc | cmp - mc
     12   --connect ADDRESS
     12   --format FORMAT
     12   --help
     12   --retry-ms N
     12   --timeout-ms N
     12   dipole
     12 Exit status: 0 
     12 Usage: dipole 
! dipole: there is no command 'top'; the commands are eval, plot, points, sample, invert, fit, texture, convert, bake, gather, table, mc, tissue, media, info, bench, help

## Each parameter is an option of both, but those of mc and fit.
$ for of in eval points; do dipole $of --help > $of; done; dipole info --format csv | sed -n 's/^parameters,\([^,]*\),.*/\1/p' | tr _ - | while read -r one; do grep -l -e "^  --$one " eval points; done | sort | uniq -c
     13 eval
     13 points

## Output that cannot be written is a failure, and said if there is somewhere to say it. Then one that needs no output.
$ fails() { for closing in '> /dev/full' '>&-' '>&- <&-' '>&- 2>&-'; do eval "$1 $closing"; echo "$closing: $?" >&2; done; eval "$1 <&- 2>&-" > x; echo "$1: $?, bytes: $(head -c 1 x | wc -c)"; }; for one in 'dipole --version' 'dipole eval --help' 'dipole eval --sigma-a .1 --sigma-s 1 --r 1' 'dipole table --sigma-a .1 --sigma-s 1 --output -' 'dipoled --help' 'dipoled --version'; do fails "$one"; done
dipole --version: 0, bytes: 1
dipole eval --help: 0, bytes: 1
dipole eval --sigma-a .1 --sigma-s 1 --r 1: 0, bytes: 1
dipole table --sigma-a .1 --sigma-s 1 --output -: 0, bytes: 1
dipoled --help: 0, bytes: 1
dipoled --version: 0, bytes: 1
! dipole: cannot write the output: No space left on device
! > /dev/full: 1
! dipole: cannot write the output: Bad file descriptor
! >&-: 1
! dipole: cannot write the output: Bad file descriptor
! >&- <&-: 1
! >&- 2>&-: 1
! dipole: cannot write the output: No space left on device
! > /dev/full: 1
! dipole: cannot write the output: Bad file descriptor
! >&-: 1
! dipole: cannot write the output: Bad file descriptor
! >&- <&-: 1
! >&- 2>&-: 1
! dipole: cannot write the output: No space left on device
! > /dev/full: 1
! dipole: cannot write the output: Bad file descriptor
! >&-: 1
! dipole: cannot write the output: Bad file descriptor
! >&- <&-: 1
! >&- 2>&-: 1
! dipole table: cannot write -: No space left on device
! dipole: cannot write the output: No space left on device
! > /dev/full: 1
! dipole table: cannot write -: Bad file descriptor
! dipole: cannot write the output: Bad file descriptor
! >&-: 1
! dipole table: cannot write -: Bad file descriptor
! dipole: cannot write the output: Bad file descriptor
! >&- <&-: 1
! >&- 2>&-: 1
! dipoled: cannot write the output: No space left on device
! > /dev/full: 1
! dipoled: cannot write the output: Bad file descriptor
! >&-: 1
! dipoled: cannot write the output: Bad file descriptor
! >&- <&-: 1
! >&- 2>&-: 1
! dipoled: cannot write the output: No space left on device
! > /dev/full: 1
! dipoled: cannot write the output: Bad file descriptor
! >&-: 1
! dipoled: cannot write the output: Bad file descriptor
! >&- <&-: 1
! >&- 2>&-: 1
