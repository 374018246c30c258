## dipole fit: what is found, and what is no success.
$ dipole eval --sigma-a 0.05 --sigma-s 1 --eta 1.4 --model better --r 0.5,1,2,4 --format csv | awk -F, 'NR == 1 { print "sample,r,R,error"; next } { print "skin," $7 "," $8 "," $8 / 100 }' > skin.csv

$ cat skin.csv
sample,r,R,error
skin,0.5,0.031035372713807588,0.000310354
skin,1,0.017629443464045762,0.000176294
skin,2,0.006070401063919001,6.0704e-05
skin,4,0.0011978417768160803,1.19784e-05

$ dipole fit skin.csv --model better --eta 1.4
model better, moments exact, scale absolute

sample  sigma_a  sigma_s'  error of a  error of s'   a by g  s' by g  correlation      chi2  readings  model error  g   g from  g sides  eta  status
           1/mm      1/mm        1/mm         1/mm     1/mm     1/mm                                      relative
------  -------  --------  ----------  -----------  -------  -------  -----------  --------  --------  -----------  -  -------  -------  ---  ------
skin       0.05         1      0.0006       0.0052  1.4e-17  2.2e-16        0.335  2.12e-23         4    not known  0  default     both  1.4  fitted

errors are standard errors; chi2 is the sum of the squares of (reading - fit) / error
model error: of R against radiative transport, which is not in the standard errors
by g: the largest change for g +- .05, since the readings may not determine g

$ dipole fit skin.csv --model better --eta 1.4 --scale free --format csv
sample,sigma_a,sigma_s_prime,sigma_a_error,sigma_s_prime_error,sigma_a_by_g,sigma_s_prime_by_g,correlation,scale,scale_error,chi2,readings,g,g_from,g_sides,eta,status
skin,0.0500000000000007,0.9999999999999961,0.004512962943682094,0.030251779004553565,3.885780586188048e-16,2.3314683517128287e-15,-0.9688287843312002,1.0000000000000082,0.057780137656808,7.836717955594742e-27,4,0,default,both,1.4,fitted

$ for s in a b c; do [ $s = b ] && n=5 || n=4; sed -n "2,${n}s/skin/$s/p" skin.csv; done | { echo sample,r,R,error; cat; } | dipole fit --model better --eta 1.4 --format csv | cut -d, -f1,2,12
sample,sigma_a,readings
a,0.05000000000000032,3
b,0.0500000000000022,4
c,0.05000000000000032,3

$ dipole fit skin.csv --model better --eta 1.4 --g 0.5 --format json
{
  "software": "dipoled 0.1.0",
  "model": "better",
  "moments": "exact",
  "axis": "r",
  "scale": "absolute",
  "notes": "similarity",
  "units": {"sigma_a": "1/mm", "sigma_s_prime": "1/mm", "sigma_a_error": "1/mm", "sigma_s_prime_error": "1/mm", "sigma_a_by_g": "1/mm", "sigma_s_prime_by_g": "1/mm", "second_sigma_a": "1/mm", "second_sigma_s_prime": "1/mm"},
  "rows": [
    {"sample": "skin", "sigma_a": 0.0500000000000022, "sigma_s_prime": 0.9999999999999923, "sigma_a_error": 5.967816010685673e-4, "sigma_s_prime_error": 0.005204203545675181, "sigma_a_by_g": 2.0816681711721685e-17, "sigma_s_prime_by_g": 3.3306690738754696e-16, "correlation": 0.33461250620544125, "scale": 1, "scale_error": 0, "chi2": 2.120165308996693e-23, "readings": 4, "model_error": null, "g": 0.5, "g_from": "option", "g_sides": "both", "eta": 1.4, "status": "fitted", "reduced_chi2": 1.0600826544983466e-23, "condition": 2.4957671945558144, "second_sigma_a": null, "second_sigma_s_prime": null, "second_chi2": null}
  ]
}

$ dipole fit skin.csv --model better
! dipole fit: sample skin: its eta is not known: give --eta X (the refractive index inside over outside), or a column eta
! `dipole fit --help` says more.
? 2

$ sed '1s/$/,eta,g,source_mm,detector_mm/; 2,$s/$/,1.4,0.8,.2,.4/' skin.csv | dipole fit --model better
model better, moments exact, scale absolute

sample   sigma_a  sigma_s'  error of a  error of s'   a by g  s' by g  correlation    chi2  readings  model error    g  g from  g sides  eta  status
            1/mm      1/mm        1/mm         1/mm     1/mm     1/mm                                    relative
------  --------  --------  ----------  -----------  -------  -------  -----------  ------  --------  -----------  ---  ------  -------  ---  ------
skin    0.050322    1.0052      0.0006       0.0052  1.4e-17  2.2e-16        0.336  0.8782         4    not known  0.8    file     both  1.4  fitted

errors are standard errors; chi2 is the sum of the squares of (reading - fit) / error
model error: of R against radiative transport, which is not in the standard errors
by g: the largest change for g +- .05, since the readings may not determine g
note: similarity: g is not 0: the model uses isotropic scattering with sigma_s (1 - g)

$ for one in 'skin.csv --reference 1,2,3' 'skin.csv --reference 1,2,3,4 --scale free' 'skin.csv --scale reference' 'skin.csv --plot fit.pdf'; do dipole fit $one || echo $?; done
2
2
2
2
! dipole fit: --reference: give four numbers: sigma_a, sigma_s, g and eta
! `dipole fit --help` says more.
! dipole fit: --reference says what the scale is: leave --scale out
! `dipole fit --help` says more.
! dipole fit: --scale reference: give --reference A,S,G,ETA in its place
! `dipole fit --help` says more.
! dipole fit: --plot fit.pdf: the name must end in .svg or .png; - is the terminal
! `dipole fit --help` says more.

$ dipole fit skin.csv --model better --eta 0
! dipole fit: bad-value: eta of medium 1 of 4: allowed: 0.001 to 1000 (--eta)
? 1

$ dipole fit skin.csv --model skin-red --eta 1.4
! dipole fit: bad-value: model: allowed: a model whose R depends on the coefficients alone (--model)
? 1

$ dipole fit /nonexistent/readings.csv
! dipole fit: /nonexistent/readings.csv: No such file or directory
? 1

$ sed '1s/$/,detector_na/; 2,$s/$/,0.3/' skin.csv | dipole fit --model better --eta 1.4
model better, moments exact, scale absolute

sample  sigma_a  sigma_s'  error of a  error of s'  a by g  s' by g  correlation  chi2  readings  model error  g   g from  g sides  eta   status
           1/mm      1/mm        1/mm         1/mm    1/mm     1/mm                                  relative
------  -------  --------  ----------  -----------  ------  -------  -----------  ----  --------  -----------  -  -------  -------  ---  -------
skin          -         -           -            -       -        -            -     -         4    not known  0  default     none  1.4  refused

errors are standard errors; chi2 is the sum of the squares of (reading - fit) / error
model error: of R against radiative transport, which is not in the standard errors
by g: the largest change for g +- .05, since the readings may not determine g
! dipole fit: sample skin: bad-value: detector_na: allowed: nothing but with transport and distances
! dipole fit: standard input: 1 of 1 samples were not fitted: see the column status
? 3

## Layers: what is found, and what is refused.
$ printf 'sample,r,R,error\ntwo,.3,.06261,.00062\ntwo,.5,.02737,.00028\ntwo,.8,.01292,.00013\ntwo,2,.002481,2.5e-5\ntwo,5,.000252,2.5e-6\nzero,1,.02,.001\nzero,2,.02,0\n' > two.csv; dipole fit two.csv --layer x,1,0,1.4,0.8 --layer x,1,0,1.4
model transport, moments exact, scale absolute

sample  unknown       value     error   status  chi2  readings  numerical error  sample is
                   1/mm, mm  1/mm, mm
------  ---------  --------  --------  -------  ----  --------  ---------------  ---------
two     sigma_a_1   0.30171    0.0032   fitted  1.04         5          2.0e-03     fitted
two     sigma_a_2  0.019379   0.00092   fitted  1.04         5          2.0e-03     fitted
zero    sigma_a_1         -       inf  refused     -         2                -    refused
zero    sigma_a_2         -       inf  refused     -         2                -    refused

errors are standard errors, inf where a value is not fitted; chi2 is the sum of the squares of (reading - fit) / error
! dipole fit: sample zero: reading 2 (line 8): bad-value: errors: allowed: above 0, and finite
! dipole fit: two.csv: 1 of 2 samples were not fitted: see the column status
? 3

$ printf 'r,R,error\n2,.02,0\n' | dipole fit --layer x,1,0,1.4,0.8 --layer .02,1,0,1.4 --format csv
sample,unknown,value,error,status,scale,scale_error,chi2,readings,numerical_error,sample_status
1,sigma_a_1,,inf,refused,,,,1,,refused
! dipole fit: sample 1: reading 1 (line 2): bad-value: errors: allowed: above 0, and finite
! dipole fit: standard input: 1 of 1 samples were not fitted: see the column status
? 3

$ for layer in 1,1,0,1.4 x,1,0,x x,1,0,1.4,1,1; do dipole fit two.csv --layer $layer; done; dipole fit two.csv --layer x,1,0,1.4 --eta 1.4; dipole fit two.csv --layer x,1,0,1.4 --model better; printf 'r,R,error,g\n1,.01,.001,0\n' | dipole fit --layer x,1,0,1.4
! dipole fit: --layer: give x for what is sought, as in --layer x,20,0.8,1.4,0.06
! `dipole fit --help` says more.
! dipole fit: --layer x,1,0,x: give SIGMA_A,SIGMA_S,G,ETA[,THICKNESS], of the two upper layers x for SIGMA_A, SIGMA_S or THICKNESS if that is sought
! `dipole fit --help` says more.
! dipole fit: --layer x,1,0,1.4,1,1: give SIGMA_A,SIGMA_S,G,ETA[,THICKNESS], of the two upper layers x for SIGMA_A, SIGMA_S or THICKNESS if that is sought
! `dipole fit --help` says more.
! dipole fit: --layer gives a layer whole, and is fitted by transport: leave --g, --eta, --thickness, --moments, --reference and --plot out
! `dipole fit --help` says more.
! dipole fit: --layer: layers are fitted by transport to the columns r, R and error, without parameters
! `dipole fit --help` says more.
! dipole fit: --layer: layers are fitted by transport to the columns r, R and error, without parameters
! `dipole fit --help` says more.
? 2

## Statuses.
$ printf 'sample,r,R,error\nfew,1,.02,.001\nzero,1,.02,0\nzero,2,.01,.001\nblank,1,.02,\nblank,2,.01,.001\norigin,0,.02,.001\norigin,2,.01,.001\nrising,1,.01,.0001\nrising,2,.02,.0001\nrising,4,.03,.0001\n' | dipole fit --model better --eta 1.4
model better, moments exact, scale absolute

sample     sigma_a  sigma_s'  error of a  error of s'  a by g  s' by g  correlation       chi2  readings  model error  g   g from  g sides  eta       status
              1/mm      1/mm        1/mm         1/mm    1/mm     1/mm                                       relative
------  ----------  --------  ----------  -----------  ------  -------  -----------  ---------  --------  -----------  -  -------  -------  ---  -----------
few              -         -           -            -       -        -            -          -         1    not known  0  default     none  1.4      refused
zero             -         -           -            -       -        -            -          -         2    not known  0  default     both  1.4      refused
blank            -         -           -            -       -        -            -          -         2    not known  0  default     both  1.4      refused
origin           -         -           -            -       -        -            -          -         2    not known  0  default     none  1.4      refused
rising  6.8455e-07   0.68455     0.00069       0.0058       -        -        0.838  9.023e+04         3    not known  0  default     both  1.4  implausible

errors are standard errors; chi2 is the sum of the squares of (reading - fit) / error
model error: of R against radiative transport, which is not in the standard errors
by g: the largest change for g +- .05, since the readings may not determine g
! dipole fit: sample few: bad-count: reading_count: allowed: 2 to 1024
! dipole fit: sample origin: reading 1 (line 7): bad-value: at: allowed: above 0 without fibres
! dipole fit: sample zero: line 3: its error must be above 0, and finite
! dipole fit: sample blank: line 5: its error must be above 0, and finite
! dipole fit: standard input: 5 of 5 samples were not fitted: see the column status
? 3

## Files that are wrong.
$ for text in '' 'r,R,error\n' 'R,error\n1,1\n' 'r,f,R,error\n1,1,1,1\n' 'r,R\n1,1\n' 'r,R,errors\n1,1,1\n' 'r,R,error,R\n1,1,1,1\n' 'r,R,error\n1,x,1\n' 'r,R,error,g\n1,1,1,0\n2,1,1,.5\n' 'r,R,error\n1,"1,1\n' 'r,R,error\n1,0,5,1\n' 'r,R,error,thickness\n1,1,1,1\n' 'r,R,error,phase_g\n1,1,1,1\n'; do printf "$text" | dipole fit --eta 1.4; done
! dipole fit: standard input: it has no header, a line that names the columns
! dipole fit: standard input: there are no readings
! dipole fit: standard input: the column r or f (one of both) is missing; the header has R, error; it needs r (distances in mm) or f (spatial frequencies in 1/mm), R and error, and may have sample, g, eta, detector_na, source_mm and detector_mm
! dipole fit: standard input: the column r or f (one of both) is missing; the header has r, f, R, error; it needs r (distances in mm) or f (spatial frequencies in 1/mm), R and error, and may have sample, g, eta, detector_na, source_mm and detector_mm
! dipole fit: standard input: the column error is missing; the header has r, R; it needs r (distances in mm) or f (spatial frequencies in 1/mm), R and error, and may have sample, g, eta, detector_na, source_mm and detector_mm
! dipole fit: standard input: the column errors is not read; the nearest that is read is error: rename it
! dipole fit: standard input: the header has the column R twice: rename one
! dipole fit: standard input: line 2: R: 'x' is no number
! dipole fit: standard input: line 3: g differs from that of the sample's other lines
! dipole fit: standard input: line 2: a quote is not closed
! dipole fit: standard input: line 2: more cells than in the header: numbers have a decimal point
! dipole fit: standard input: the column thickness is of no medium that can be fitted: those are half spaces that scatter by Henyey-Greenstein's function
! dipole fit: standard input: the column phase_g is of no medium that can be fitted: those are half spaces that scatter by Henyey-Greenstein's function
? 1

## Names that are no UTF-8; the order of lines, and columns that are not read.
$ printf 'sample,r,R,error\n"a\377\300\257\355\240\200\365 b\303\244\360\237\230\200",.5,.02,.0004\n"a\377\300\257\355\240\200\365 b\303\244\360\237\230\200",1,.006,.0001\n"a\377\300\257\355\240\200\365 b\303\244\360\237\230\200",2,.001,.00002\n' | dipole fit --model better --eta 1.4 --format json | grep -o '"sample": "[^"]*"'
"sample": "a\ufffd\ufffd\ufffd\ufffd\ufffd\ufffd\ufffd bä😀"
! dipole fit: standard input: 1 of 1 samples were not fitted: see the column status

$ printf 'sample,r,R,error\na,.5,.02,.0004\na,1,.006,.0001\na,2,.001,.00002\nb,.5,.03,.0004\nb,1,.009,.0001\nb,2,.0015,.00002\n' | dipole fit --model better --eta 1.4 --format csv > x; printf '# a comment\r\nwho,error,R,comment,r,sample\r\n\r\nme,.0004,.02,"odd, ""quoted""",.5,a\r\nme,.0004,.03,,.5,b\r\nme,.0001,.006,,1,a\r\nme,.0001,.009,,1,b\r\nme,.00002,.001,,2,a\r\nme,.00002,.0015,,2,b\r\n' | dipole fit --model better --eta 1.4 --format csv | cmp - x
! dipole fit: standard input: 2 of 2 samples were not fitted: see the column status
! dipole fit: standard input: 2 of 2 samples were not fitted: see the column status

$ dipole eval --sigma-a 0.01 --sigma-s 1 --eta 1.4 --model better --r 0.5,1,2,4 --format csv > known; paste -d, skin.csv known | awk -F, 'NR == 1 { print "r,R,error"; next } { print $2 "," $3 / $12 "," $3 / $12 / 100 }' | dipole fit --model better --eta 1.4 --reference 0.01,1,0,1.4 --format csv | cut -d, -f2,3,9,17
sigma_a,sigma_s_prime,scale,status
0.04999999926800088,0.9999998431541128,1,fitted

$ dipole fit two.csv $(for i in 1 2 3 4 5 6 7 8 9; do echo --layer x,1,0,1.4,1; done)
! dipole fit: --layer: 9 layers: give at most 8
! `dipole fit --help` says more.
? 2

$ for i in a b c d e f g h i; do sed 1d skin.csv | sed s/skin/$i/; done | cat - | sed '1s/^/sample,r,R,error\n/' | dipole fit --model better --eta 1.4 --plot nine.svg --format csv | wc -l
10
! dipole fit: the picture shows the first 8 of 9 samples

## A g is left out that transport's table does not hold. No change is told where readings see g; better sees none.
$ dipole eval --model transport --sigma-a .02 --sigma-s 10 --g .9 --eta 1.4 --r 1,1.5,2.5,4.5 --wanted R --format csv > seen; for one in '-.5 .1' '0 .1' '.9 .1' '.93 .1' '.9 .0003'; do awk -F, -v g=${one% *} -v share=${one#* } 'NR > 1 { print g " " share "," $7 "," $8 "," share * $8 "," g }' seen; done | sed '1i sample,r,R,error,g' > g.csv; for model in transport better; do [ $model = better ] && sed -i /0003/d g.csv; dipole fit g.csv --model $model --eta 1.4 --format csv | awk -F, 'NR > 1 { print $1 ": g " $13 ", " $15 ", " $17 (($6 $7) == "" ? "" : $6 < 1e-8 && $7 < 1e-8 ? ", no change" : ", changes") }'; done
-.5 .1: g -0.5, above, fitted, changes
0 .1: g 0, both, fitted, changes
.9 .1: g 0.9, both, fitted, changes
.93 .1: g 0.93, below, fitted, changes
.9 .0003: g 0.9, both, fitted
-.5 .1: g -0.5, both, fitted, no change
0 .1: g 0, both, fitted, no change
.9 .1: g 0.9, both, fitted, no change
.93 .1: g 0.93, both, fitted, no change

## Apertures of the file and of the option: a is the same in both, b is not. The other models have none (above).
$ dipole eval --model better --sigma-a .01 --sigma-s 1.5 --eta 1.4 --r .5,1,2,4 --wanted R --format csv | awk -F, 'NR > 1 { print $7 "," $8 "," $8 / 100 }' > milk; awk -F, '{ R = .05 * $2; for (of = 0; of < 2; of++) print substr("ab", of + 1, 1) "," $1 "," R "," .02 * R "," (of ? "WIDE" : "") }' milk | sed '1i sample,r,R,error,detector_na' > na.csv; sed 's/WIDE//' na.csv | dipole fit --model transport --eta 1.4 --detector-na .22 --format csv | cut -d, -f-3,17
sample,sigma_a,sigma_s_prime,status
a,0.005419836919700163,1.7324680998664164,fitted
b,0.005419836919700163,1.7324680998664164,fitted

$ sed 's/WIDE/.3/' na.csv > wide.csv; dipole fit wide.csv --model transport --eta 1.4 --detector-na .22; dipole fit wide.csv --model transport --eta 1.4 --detector-na .22 --format json | grep -o '"model_error": [^,]*'
model transport, moments exact, detector_na 0.22, scale absolute

sample    sigma_a  sigma_s'  error of a  error of s'   a by g  s' by g  correlation  chi2  readings  model error  g   g from  g sides  eta  status
             1/mm      1/mm        1/mm         1/mm     1/mm     1/mm                                  relative
------  ---------  --------  ----------  -----------  -------  -------  -----------  ----  --------  -----------  -  -------  -------  ---  ------
a       0.0054198    1.7325     0.00054        0.026  0.00041    0.026        0.031  10.9         4      2.2e-02  0  default    above  1.4  fitted
b        0.041132    1.0779      0.0011        0.015   0.0011    0.015        0.405   7.8         4      2.2e-02  0  default    above  1.4  fitted

errors are standard errors; chi2 is the sum of the squares of (reading - fit) / error
model error: of R against radiative transport, which is not in the standard errors
by g: the largest change for g +- .05, since the readings may not determine g
"model_error": 0.022
"model_error": 0.022

## A name is no command: gnuplot runs the next line of a text that is not closed, and what ` and @ hold; four quotes end a text in quotes, though two do not.
$ for ends in '\n \r \r\n \302\205 \033' "\\\\\\n ' '' \"\""; do for end in $ends; do while read -r line; do printf "\"a$end . system(\"\"touch hit\"\") . $end; \`touch hit\` @hit #$end\",$line\n"; done < milk; done | sed '1i sample,r,R,error' | dipole fit --model better --eta 1.4 --plot a.svg --plot a.png --plot - | grep -o 'a[^ ]* \. system.*' | sed 's/  .*//'; grep 'touch hit' a.svg | sed 's/<[^>]*>//g'; rm a.svg a.png; done; test -e hit || echo none ran
a? . system("touch hit") . ?; `touch hit` @hit #?
a? . system("touch hit") . ?; `touch hit` @hit #?
a?? . system("touch hit") . ??; `touch hit` @hit #??
a?? . system("touch hit") . ??; `touch hit` @hit #??
a? . system("touch hit") . ?; `touch hit` @hit #?
a? . system("touch hit") . ?; `touch hit` @hit #?
a? . system("touch hit") . ?; `touch hit` @hit #?
a?? . system("touch hit") . ??; `touch hit` @hit #??
a?? . system("touch hit") . ??; `touch hit` @hit #??
a? . system("touch hit") . ?; `touch hit` @hit #?
a? . system("touch hit") . ?; `touch hit` @hit #?
a? . system("touch hit") . ?; `touch hit` @hit #?
a?? . system("touch hit") . ??; `touch hit` @hit #??
a?? . system("touch hit") . ??; `touch hit` @hit #??
a? . system("touch hit") . ?; `touch hit` @hit #?
		a? . system("touch hit") . ?; `touch hit` @hit #?
		a? . system("touch hit") . ?; `touch hit` @hit #?
		a?? . system("touch hit") . ??; `touch hit` @hit #??
		a?? . system("touch hit") . ??; `touch hit` @hit #??
		a? . system("touch hit") . ?; `touch hit` @hit #?
a\? . system("touch hit") . \?; `touch hit` @hit #\?
a' . system("touch hit") . '; `touch hit` @hit #'
a'' . system("touch hit") . ''; `touch hit` @hit #''
a" . system("touch hit") . "; `touch hit` @hit #"
a\? . system("touch hit") . \?; `touch hit` @hit #\?
a' . system("touch hit") . '; `touch hit` @hit #'
a'' . system("touch hit") . ''; `touch hit` @hit #''
a" . system("touch hit") . "; `touch hit` @hit #"
a\? . system("touch hit") . \?; `touch hit` @hit #\?
a' . system("touch hit") . '; `touch hit` @hit #'
a'' . system("touch hit") . ''; `touch hit` @hit #''
a" . system("touch hit") . "; `touch hit` @hit #"
		a\? . system("touch hit") . \?; `touch hit` @hit #\?
		a' . system("touch hit") . '; `touch hit` @hit #'
		a'' . system("touch hit") . ''; `touch hit` @hit #''
		a" . system("touch hit") . "; `touch hit` @hit #"
none ran
