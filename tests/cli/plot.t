## dipole plot: text, and wrong command lines.
$ dipole plot --medium skin1 --channel red --model better,transport --count 60 --error

                 skin1: R (1/mm^2 per unit of power that entered)
 1e+01 +--------------------------------------------------------------------+
       |oo.oo                 +                      +                     +|
       |+    oooooo.o                                                      +|
 1e+00 |-+           oooooo                                               +-|
       |+                  o.oooooo                                        +|
 1e-01 |++                         oo.ooo                                 ++|
       |+                                ooooo.o                           +|
       |**.********.********.********.********.*ooooo                      +|
 1e-02 |-+                                           oo.ooo*              +-|
       |+                                                  oooo*           +|
       |+                                                      o.ooo       +|
 1e-03 |-+                                                          oo*   +-|
       |+                                                             oo*  +|
 1e-04 |++                                                              o.o+|
       |+                                                                  o|
       |+                     +                      +                     +|
 1e-05 +--------------------------------------------------------------------+
       0.01                  0.1                     1                     10
                                      r (mm)
                         +..*..+better    +..o..+transport

                        skin1: deviation from transport (%)
   40 +---------------------------------------------------------------------+
      |+                      +                     +                      +|
   20 |-+                                                .*******.*       +-|
      |                                                **          ******   |
      |                                              **                  .**|
    0 |oo.ooooooo.ooooooo.ooooooo.ooooooo.ooooooo.ooooooo.ooooooo.ooooooo.oo|
      |                                            *                        |
  -20 |-+                                        .*                       +-|
      |                                         *                           |
  -40 |-+                                     **                          +-|
      |                                      *                              |
  -60 |-+                                   *                             +-|
      |                                  .**                                |
      |                               ***                                   |
  -80 |-+                          ***                                    +-|
      |+                 .*******.*                 +                      +|
 -100 +---------------------------------------------------------------------+
      0.01                   0.1                    1                      10
                                      r (mm)
                         +..*..+better    +..o..+transport

$ dipole eval --medium skin1 --model better --r 0.1,1,2 --plot - | tail -24
cdf's model error is, and of R_f over the albedo
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.982987 (eta 1.3)

                 skin1: R (1/mm^2 per unit of power that entered)
 1e-01 +--------------------------------------------------------------------+
       |+    +      +     +     +     +      +     +     +     +      +    +|
       |+                                                                  +|
       |+ +.............                                                   +|
       |+     ........................*.......                             +|
 1e-02 |-+           .......   .......o.....  ................            +-|
       |+                   .......         ..........        ........*    +|
       |+                          ...+...            ...........          +|
       |+                                 ........               .....o    +|
       |+                                         ........                 +|
       |                                                  ........          |
 1e-03 |-+                                                        ....+   +-|
       |+                                                                  +|
       |+                                                                  +|
       |+                                                                  +|
       |     +      +     +     +     +      +     +     +     +      +     |
 1e-04 +--------------------------------------------------------------------+
       0    0.2    0.4   0.6   0.8    1     1.2   1.4   1.6   1.8     2    2.2
                                      r (mm)
           +..*..+better, red   +..o..+better, green +..+..+better, blue

$ for one in '' '--medium skin1 --axes log' '--medium skin1 --quantity colour' '--medium skin1 --quantity albedo' '--medium skin1 --error --thickness 1' '--medium skin1 --plot r.pdf' '--medium skin1 --r 1 --to 3' '--medium skin1 --axes linear --log' '--medium skin1 --f 1' '--medium skin1 --mc 0' '--medium skin1 --mc 1e3 --r 1,2' '--medium skin1 --mc 1e3 --quantity cdf' '--medium skin1 --mc 1e3 --count 4097' '--medium skin1 --mc 1e3 --from 3 --to 2' '--medium skin1, --model better'; do dipole plot $one || echo $?; done
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
! dipole plot: give --medium NAME, or --sigma-a and --sigma-s, or --layer
! `dipole plot --help` says more.
! dipole plot: --axes: 'log' is unknown; they are linear, semilog and logarithmic
! `dipole plot --help` says more.
! dipole plot: --quantity: 'colour' is unknown; this daemon has R, albedo, cdf, r, ...
! `dipole plot --help` says more.
! dipole plot: --quantity albedo: there is no curve of it over r; name another quantity
! `dipole plot --help` says more.
! dipole plot: --error compares with transport, which has no slabs: leave --thickness out
! `dipole plot --help` says more.
! dipole plot: --plot r.pdf: the name must end in .svg or .png; - is the terminal
! `dipole plot --help` says more.
! dipole plot: --r gives the radii one by one: leave --from, --to, --count and --log out
! `dipole plot --help` says more.
! dipole plot: --log needs --from, above 0
! `dipole plot --help` says more.
! dipole plot: what ends with _f is at the spatial frequencies of --f, all else at the radii of --r: request one of both
! `dipole plot --help` says more.
! dipole plot: --mc: give a whole number of photons from 1 to 9e15, such as 1e6
! `dipole plot --help` says more.
! dipole plot: --mc draws means of R over rings: give --from, --to and --count in place of --r, --f and --quantity
! `dipole plot --help` says more.
! dipole plot: --mc draws means of R over rings: give --from, --to and --count in place of --r, --f and --quantity
! `dipole plot --help` says more.
! dipole plot: --mc: give 1 to 4096 rings, from --from, 0 or more, to --to, which is larger
! `dipole plot --help` says more.
! dipole plot: --mc: give 1 to 4096 rings, from --from, 0 or more, to --to, which is larger
! `dipole plot --help` says more.
! dipole plot: --medium: '' is unknown; this daemon has apple, chicken1, chicken2, cream, ketchup, marble, potato, skimmilk, skin-dark, skin-light, skin-medium, skin1, skin2, spectralon, wholemilk
! `dipole plot --help` says more.

$ for one in '--medium skin1 --to -1' '--medium skin1 --quantity dR_dr --model better' '--medium skin1 --model single --r 0' '--sigma-a 0.1 --sigma-s 1 --eta 5 --model better --error' '--sigma-a 0.05 --sigma-s 50 --g 0.995 --eta 1.4 --model better --error'; do dipole plot $one || echo $?; done
1
1
1
1
1
! dipole plot: bad-value: radius_stop: allowed: at least radius_start, finite (--to)
! dipole plot: --plot: dR_dr (1/mm^3) is 0, negative or infinite everywhere, which these axes do not show: try other radii, or `dipole plot --axes linear`
! dipole plot: --plot: R (1/mm^2 per unit of power that entered) is 0, negative or infinite everywhere, which these axes do not show: try other radii, or `dipole plot --axes linear`
! dipole plot: transport is left out: bad-value: eta: allowed: 0.25 to 4 with transport (--eta)
! dipole plot: --error: there is nothing to compare with: leave --error out
! dipole plot: transport is left out: bad-value: g: allowed: -0.98 to 0.99 with transport (--g)
! dipole plot: --error: there is nothing to compare with: leave --error out

## Transport is compared with although it does not take the parameter.
$ dipole plot --medium skin1 --channel red --model burley --surface-albedo .3 --error --r 1,2,4 --plot a.svg; grep -o 'transport\|>burley<' a.svg | sort | uniq -c
      1 >burley<
      1 transport

$ dipole plot --layer .1,10,.8,1.4,.1 --layer .02,10,.8,1.4 --r 1,2 --model transport --plot b.svg; grep -o '2 layers' b.svg; dipole eval --medium skin1 --wanted cdf,R --r 1,2 --model better --plot c.svg > /dev/null; head -c 5 c.svg; echo
2 layers
<?xml

$ dipole plot --medium skin1,marble --g .9 --channel red --error --plot d.svg --from 0 --to 2 --model better

$ dipole plot --medium skin1 --channel red --model better,transport --surface-albedo .3 --error
! dipole plot: model better: bad-value: surface_albedo: allowed: nothing: this model does not take it (--surface-albedo)
? 1

## A file name that starts with | is only a name: gnuplot itself would run it as a command.
$ dipole plot --medium skin1 --model better --plot '|touch hit;.svg'; ls; rm -f '|touch hit;.svg'
a.svg
b.svg
c.svg
d.svg
|touch hit;.svg

## A picture that fails leaves the file as it was: without gnuplot, and where it fails or draws nothing.
$ echo old > r.svg; for to in r.svg -; do PATH=. "$(command -v dipole)" plot --medium skin1 --model better --plot $to; done; cat r.svg
old
! dipole plot: --plot r.svg: gnuplot is not installed; install the package gnuplot-nox
! dipole plot: --plot -: gnuplot is not installed; install the package gnuplot-nox

$ mkdir fake; printf '#!/bin/sh\nprintf "no fonts today" >&2; exit 3\n' > fake/gnuplot; chmod +x fake/gnuplot; PATH=$PWD/fake:$PATH dipole plot --medium skin1 --model better --plot r.svg; printf '#!/bin/sh\nexit 0\n' > fake/gnuplot; PATH=$PWD/fake:$PATH dipole plot --medium skin1 --model better --plot r.svg || cat r.svg
old
! dipole plot: --plot r.svg: gnuplot failed: no fonts today
! dipole plot: --plot r.svg: gnuplot failed:...

$ dipole plot --medium skin1 --model better --plot none/r.svg
! dipole plot: --plot none/r.svg: cannot write it: No such file or directory
? 1

## The demonstration without programs, and with a daemon that does not start, which leaves nothing behind.
$ sh $REPOSITORY/clients/demo.sh nothing
! demo: nothing/dipoled is not there: run make first
? 1

$ mkdir copied left; cp $(dirname $(command -v dipoled))/dipole copied; printf '#!/bin/sh\necho out of sockets >&2\nexit 1\n' > copied/dipoled; chmod +x copied/dipoled; TMPDIR=$PWD/left sh $REPOSITORY/clients/demo.sh copied > shown; echo $?; ls left
1
! out of sockets
! dipole eval: ...
! demo: the evaluation failed
