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

## The README's picture is current: `make figures` draws it by this command. Both have the same texts, and 18 curves.
$ dipole plot --medium skin1 --model classical,better,transport --error --plot e.svg; cp $REPOSITORY/clients/cli/skin1.svg kept.svg; for file in e kept; do grep -c '<g id="gnuplot_plot_' $file.svg; sed -n '/<text/,/<\/text>/p' $file.svg | grep -o '>[^<]*<' | sort > $file.texts; done; grep -c . e.texts; cmp e.texts kept.texts
18
18
75

## A fit: gnuplot gets the readings and their errors, and below the residuals over these, of the curve.
$ printf '#!/bin/sh\ncat\n' > fake/gnuplot; printf 'sample,r,R,error\na,1,.0234,.0005\na,2,.00787,.0002\na,4,.00159,.00003\n' | PATH=$PWD/fake:$PATH dipole fit --model better --eta 1.4 --plot f.svg > /dev/null; grep -E '^(T.*|lower_label) =' f.svg; awk '/^END/ { exit } f && NF; /<< END/ { f = 1 }' f.svg
lower_label = "residual \0057 error"
T[1] = ""
T[2] = "a"
1 0.023395020874762119 0 0 0
2 0.0078742540401520438 0 0 0
4 0.0015898268685960127 0 0 0
1 0.023400000000000001 0.00050000000000000001 0.0099582504757625423 0
2 0.0078700000000000003 0.00020000000000000001 -0.021270200760217794 0
4 0.0015900000000000001 3.0000000000000001e-05 0.0057710467995771356 0

## The demonstration.
$ rm copied/dipoled; ln -s $(command -v dipoled) copied; mkdir after; TMPDIR=$PWD/after sh $REPOSITORY/clients/demo.sh copied | sed 's/^[$]/>/'; ls after; head -c 5 copied/demo/skin1.svg; echo; grep -c '<g id="gnuplot_plot_' copied/demo/skin1.svg; for part in head tail; do $part -c 8 copied/demo/skin1.png | grep -aoE 'PNG|IEND'; done; find copied/demo -name '*.png' -size +5000c; head -1 copied/demo/skin1.csv
> copied/dipole eval --medium skin1 --model transport,classical,better --from 0.1 --to 10 --log --channel red --count 9
skin1, moments exact, R in 1/mm^2 per unit of power that entered

           transport   classical      better
       r       R red       R red       R red
      mm      1/mm^2      1/mm^2      1/mm^2
--------  ----------  ----------  ----------
     0.1  3.3067e-01  4.4037e-02  2.6214e-02
0.177828  1.6342e-01  4.3201e-02  2.5829e-02
0.316228  7.7430e-02  4.0723e-02  2.4681e-02
0.562341  3.5325e-02  3.4265e-02  2.1625e-02
       1  1.5701e-02  2.2021e-02  1.5482e-02
 1.77828  6.6663e-03  9.1652e-03  8.0148e-03
 3.16228  2.4144e-03  2.5999e-03  2.9122e-03
 5.62341  6.0506e-04  5.7339e-04  6.9149e-04
      10  7.9313e-05  7.4269e-05  8.4214e-05

                                                                      R            R           albedo       albedo
model      channel  sigma_a  sigma_s  g  eta    albedo  numerical error  model error  numerical error  model error  evaluator  notes
                       1/mm     1/mm                 1
---------  -------  -------  -------  -  ---  --------  ---------------  -----------  ---------------  -----------  ---------  -----
transport  red        0.032     0.74  0  1.3  0.439458          8.3e-05      0.0e+00          8.3e-05      0.0e+00        lut
classical  red        0.032     0.74  0  1.3  0.436049          7.2e-15      8.7e-01          2.4e-15      7.8e-03        f64
better     red        0.032     0.74  0  1.3  0.404808          7.1e-15      9.2e-01          2.4e-15      7.9e-02        f64
numerical error: at most, against the model's formula, at r = 0.1 to 10 mm
model error: the largest, of the model against radiative transport
errors are relative, but of ln R, its derivatives, paths and modulated light absolute, as the
cdf's model error is, and of R_f over the albedo
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.982987 (eta 1.3)
> copied/dipole eval --sigma-a 0.05 --sigma-s 9.5 --g 0.9 --eta 1.4 --tolerance 0.01 --r 0.1,1,5
moments exact, tolerance 0.01, R in 1/mm^2 per unit of power that entered

      transport
  r         R 1
 mm      1/mm^2
---  ----------
0.1  1.4494e-01
  1  1.6164e-02
  5  6.3481e-04

                                                                        R            R           albedo       albedo
model      channel  sigma_a  sigma_s    g  eta    albedo  numerical error  model error  numerical error  model error  evaluator  notes
                       1/mm     1/mm                   1
---------  -------  -------  -------  ---  ---  --------  ---------------  -----------  ---------------  -----------  ---------  -----
transport  1           0.05      9.5  0.9  1.4  0.361312          5.2e-04      0.0e+00          4.5e-06      0.0e+00        f32
numerical error: at most, against the model's formula, at r = 0.1 to 5 mm
model error: the largest, of the model against radiative transport
errors are relative, but of ln R, its derivatives, paths and modulated light absolute, as the
cdf's model error is, and of R_f over the albedo
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.972222 (eta 1.4)
took transport (f32), the cheapest that keeps the tolerance

The three profiles over r, on logarithmic axes:
  copied/demo/skin1.svg
  copied/demo/skin1.png
  copied/demo/skin1.csv

In red, from 0.1 to 10 mm, the classical dipole is up to 87 % from transport, at 0.1 mm, and from 2 mm on up to 31 %; the better dipole is up to 92 % from transport, at 0.1 mm, and from 2 mm on up to 22 %.
<?xml
9
PNG
IEND
copied/demo/skin1.png
model,channel,sigma_a,sigma_s,g,eta,r,R,albedo,numerical_error,model_error,numerical_error_R,model_error_R,numerical_error_albedo,model_error_albedo,evaluator,notes
