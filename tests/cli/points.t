## dipole points: rows of CSV, and the same rows with results.
$ printf 'sigma_a,sigma_s,g,eta,r\n0.01,1,0,1.4,2\n' > one.csv

$ dipole points one.csv --model better
sigma_a,sigma_s,g,eta,r,R,albedo,cdf,status
0.01,1,0,1.4,2,0.008922392411638412,0.605952712135344,0.37076385200174106,ok

$ dipole points --model better - < one.csv
sigma_a,sigma_s,g,eta,r,R,albedo,cdf,status
0.01,1,0,1.4,2,0.008922392411638412,0.605952712135344,0.37076385200174106,ok

$ dipole points one.csv
sigma_a,sigma_s,g,eta,r,R,albedo,cdf,status
0.01,1,0,1.4,2,0.0076295505,0.6222119489494612,0.44686064,ok

$ dipole points one.csv --model better --errors --wanted R,ln_R
sigma_a,sigma_s,g,eta,r,R,ln_R,numerical_error,model_error,status
0.01,1,0,1.4,2,0.008922392411638412,-4.719191160768661,2.696377747089643e-15,0.1694556622729013,ok

## The error grows with the radius, as that of eval does.
$ printf 'sigma_a,sigma_s,g,eta,r\n0.001,1,0,1.4,1000\n' | dipole points --model classical+single --wanted R --errors | tail -1 | cut -d, -f7 > error; dipole eval --model classical+single --sigma-a 0.001 --sigma-s 1 --g 0 --eta 1.4 --r 1000 --wanted R --format csv | tail -1 | cut -d, -f9 | diff - error && grep -c 'e-12' error
1

$ dipole points one.csv --tolerance 0.01
sigma_a,sigma_s,g,eta,r,R,albedo,status
0.01,1,0,1.4,2,0.0076295505,0.6222119489494612,ok

$ printf 'note,r,eta,"sigma_s",x,g,sigma_a\n"a, ""b""",2,1.4,"1",,0,0.01\n' | dipole points --model better
note,r,eta,"sigma_s",x,g,sigma_a,R,albedo,cdf,status
"a, ""b""",2,1.4,"1",,0,0.01,0.008922392411638412,0.605952712135344,0.37076385200174106,ok

$ printf 'status,R,sigma_a,sigma_s,g,eta,r,cdf\nold,,0.01,1,0,1.4,2,0.5\n' | dipole points --model better
status,R,sigma_a,sigma_s,g,eta,r,cdf,albedo
ok,0.008922392411638412,0.01,1,0,1.4,2,0.37076385200174106,0.605952712135344

$ printf 'model,moments,sigma_a,sigma_s,g,eta,r\n,,0.01,1,0,1.4,2\nclassical,exact,0.01,1,0,1.4,2\nbetter,fit,0.01,1,0,1.4,2\n' | dipole points --model better
model,moments,sigma_a,sigma_s,g,eta,r,R,albedo,cdf,status
,,0.01,1,0,1.4,2,0.008922392411638412,0.605952712135344,0.37076385200174106,ok
classical,exact,0.01,1,0,1.4,2,0.008326543417472774,0.6143012732546794,0.47532914377251423,ok
better,fit,0.01,1,0,1.4,2,0.008920954899251361,0.6059542968596644,0.3709327583664257,ok

$ printf 'sigma_a,sigma_s,g,eta,r\n0,1,0,1.4,0\n0,1,0,1.4,inf\n0.5,0,0,1.4,1\n0.5,1,0,1.4,1e300\n' | dipole points --model better
sigma_a,sigma_s,g,eta,r,R,albedo,cdf,status
0,1,0,1.4,0,0.047730611659079394,1,0,ok
0,1,0,1.4,inf,0,1,1,ok
0.5,0,0,1.4,1,0,0,0,ok
0.5,1,0,1.4,1e300,0,0.05716114249570865,1,ok

$ printf 'sigma_a,sigma_s,g,eta,r' | dipole points
sigma_a,sigma_s,g,eta,r,R,albedo,cdf,status

$ printf '# media, "odd\n\nsigma_a,sigma_s,g,eta,r\n#\n0.01,1,0,1.4,2\n\n  \n# end' | dipole points --model better
# media, "odd

sigma_a,sigma_s,g,eta,r,R,albedo,cdf,status
#
0.01,1,0,1.4,2,0.008922392411638412,0.605952712135344,0.37076385200174106,ok

  
# end

$ printf 'medium,channel,r,sigma_a,sigma_s\nskin1,red,1,,0.5\nskin1,red,1,0.1,\nskin1,red,1,0.1,0.5\n' | dipole points --model better --wanted R
medium,channel,r,sigma_a,sigma_s,R,status
skin1,red,1,,0.5,,sigma_a: '' is no number: allowed: decimal numbers within the range of doubles
skin1,red,1,0.1,,,sigma_s: '' is no number: allowed: decimal numbers within the range of doubles
skin1,red,1,0.1,0.5,,g: '' is no number: allowed: decimal numbers within the range of doubles
! dipole points: standard input: 3 of 3 rows were bad: see the column status
? 3

$ printf 'medium,channel,r,eta\nskin1,red,1,\nskin1,blue,1,1.4\nmy own,red,1,1.3\nskin1,,1,\n' | dipole points --model better --wanted R
medium,channel,r,eta,R,status
skin1,red,1,,0.015481882273229152,ok
skin1,blue,1,1.4,0.004954157187455209,ok
my own,red,1,1.3,,"medium: 'my own' is unknown: allowed: those of `dipole media`, or any text with sigma_a and sigma_s"
skin1,,1,,,"channel: '': allowed: red, green, blue"
! dipole points: standard input: 2 of 4 rows were bad: see the column status
? 3

$ printf 'medium,sigma_a,sigma_s,g,eta,r\nmy own,0.01,1,0,1.4,2\n' | dipole points --model better --wanted cdf,pdf
medium,sigma_a,sigma_s,g,eta,r,cdf,pdf,status
my own,0.01,1,0,1.4,2,0.37076385200174106,0.18503438893157545,ok

$ printf 'sigma_a,sigma_s,g,eta\n0.01,10,0.9,1.4\n' | dipole points --model better --f 0.1,1
sigma_a,sigma_s,g,eta,f,albedo,R_f,status
0.01,10,0.9,1.4,0.1,0.605952712135344,0.21323395498981187,ok
0.01,10,0.9,1.4,1,0.605952712135344,3.516034949555704e-4,ok

$ printf 'sigma_a,sigma_s,g,eta,f\n0.01,10,0.9,1.4,1\n' | dipole points --model better --wanted R_f
sigma_a,sigma_s,g,eta,f,R_f,status
0.01,10,0.9,1.4,1,3.516034949555704e-4,ok

$ printf 'sigma_a,sigma_s,g,eta\n0.01,10,0.9,1.4\n' | dipole points --wanted R_f
! dipole points: standard input: the column f is missing; the header has sigma_a, sigma_s, g, eta; it needs sigma_a, sigma_s, g and eta, or medium and channel, or layers; and r unless --r is given; and may have model, moments and parameters
? 1

$ printf 'sigma_a,sigma_s,g,eta,f\n0.01,10,0.9,1.4,1\n' | dipole points --f 1
! dipole points: standard input: the header has the column f: leave --f out, or rename the column
? 1

$ dipole points --f 1 --wanted R one.csv
! dipole points: what ends with _f is at the spatial frequencies of --f or a column f: request it alone, without --r
! `dipole points --help` says more.
? 2

$ dipole points --wanted r one.csv
! dipole points: --wanted r: r is a column of the input, or of --r: leave it out
! `dipole points --help` says more.
? 2

$ dipole points --wanted model_error one.csv
! dipole points: --wanted model_error: it is written beside the values; `dipole points` has --errors for it
! `dipole points --help` says more.
? 2

$ dipole points --r 1 one.csv
! dipole points: one.csv: the header has the column r: leave --r out, or rename the column
? 1

$ dipole media --format csv | head -2 | dipole points --model better --r 0.5,1 --wanted R
medium,channel,sigma_a,sigma_s,g,eta,layers,r,R,status
apple,red,3e-3,2.29,0,1.3,,0.5,0.12148094122340175,ok
apple,red,3e-3,2.29,0,1.3,,1,0.04671749693152233,ok

## Parameters: an option holds where the cell is empty.
$ printf 'model,sigma_a,sigma_s,g,eta,r,thickness\nmultipole,0.01,1,0,1.4,2,\nmultipole,0.01,1,0,1.4,2,4\n' > slabs.csv

$ dipole points slabs.csv --wanted R --thickness 3
model,sigma_a,sigma_s,g,eta,r,thickness,R,status
multipole,0.01,1,0,1.4,2,,0.007858450025664251,ok
multipole,0.01,1,0,1.4,2,4,0.008069365771798391,ok

$ dipole points slabs.csv --wanted R
model,sigma_a,sigma_s,g,eta,r,thickness,R,status
multipole,0.01,1,0,1.4,2,,,bad-value: thickness: allowed: above 0 mm: this model is of a slab
multipole,0.01,1,0,1.4,2,4,0.008069365771798391,ok
! dipole points: slabs.csv: 1 of 2 rows were bad: see the column status
? 3

$ printf 'model,sigma_a,sigma_s,g,eta,r,fit_model\ngaussians,0.01,1,0,1.4,2,classical\ngaussians,0.01,1,0,1.4,2,1\ngaussians,0.01,1,0,1.4,2,\n' | dipole points --wanted R
model,sigma_a,sigma_s,g,eta,r,fit_model,R,status
gaussians,0.01,1,0,1.4,2,classical,0.00833111696184202,ok
gaussians,0.01,1,0,1.4,2,1,0.00833111696184202,ok
gaussians,0.01,1,0,1.4,2,,0.008924525157374585,ok

## Bad rows say why, and the others go on.
$ printf 'model,moments,sigma_a,sigma_s,g,eta,r,cos_in\nbest,,0.01,1,0,1.4,2,\n,exakt,0.01,1,0,1.4,2,\n,,-0.01,1,0,1.4,2,\n,,0.01,1,0,0,2,\n,,0.01,1,0,1.4,,\n,,0x1,1,0,1.4,2,\n,,"0,01",1,0,1.4,2,\n,,0.01,1,0,1.4\n,,0.01,1,0,1.4,2,,3,4\n"a"b,,0.01,1,0,1.4,2,\n,,0.01,1,0,1.4,2,2\n,,0.01,1,0,1.4,2,x\n,,0.01,1,0,1.4,2,\n' | dipole points --model better --wanted R
model,moments,sigma_a,sigma_s,g,eta,r,cos_in,R,status
best,,0.01,1,0,1.4,2,,,"model: 'best' is unknown: allowed: classical, better, grosjean, boundary, exitance, grosjean-boundary, grosjean-exitance, boundary-exitance, extended, quantized, beam, single, ..."
,exakt,0.01,1,0,1.4,2,,,"moments: 'exakt' is unknown: allowed: exact, fit, jensen, pbrt"
,,-0.01,1,0,1.4,2,,,bad-value: sigma_a: allowed: 0 to 1e15 per mm
,,0.01,1,0,0,2,,,bad-value: eta: allowed: 0.001 to 1000
,,0.01,1,0,1.4,,,,r: '' is no number: allowed: decimal numbers within the range of doubles
,,0x1,1,0,1.4,2,,,sigma_a: '0x1' is no number: allowed: decimal numbers within the range of doubles
,,"0,01",1,0,1.4,2,,,"sigma_a: '0,01' is no number: allowed: decimal numbers within the range of doubles: write a decimal point"
,,0.01,1,0,1.4,,,,"the row: 6 cells: allowed: 8, as many as in the header"
,,0.01,1,0,1.4,2,,,"the row: 10 cells: allowed: 8, as many as in the header",3,4
"a"b,,0.01,1,0,1.4,2,,,"the row: text after a closing quote: allowed: quotes around whole cells, doubled within"
,,0.01,1,0,1.4,2,2,,bad-value: cos_in: allowed: 0 to 1
,,0.01,1,0,1.4,2,x,,"cos_in: 'x' is no value: allowed: 1: cosine of the angle of incidence, for S; else 1 (0 to 1)"
,,0.01,1,0,1.4,2,,0.008922392411638412,ok
! dipole points: standard input: 12 of 13 rows were bad: see the column status
? 3

$ printf 'R,status,sigma_a,sigma_s,g,eta,r\n1,ok,0.01,1,0,1.4,-1\n' | dipole points --model better --wanted R
R,status,sigma_a,sigma_s,g,eta,r
,"bad-value: r: allowed: 0 to infinity, in mm",0.01,1,0,1.4,-1
! dipole points: standard input: 1 of 1 rows were bad: see the column status
? 3

## Bad files.
$ printf 'model,sigma_a,R,eta,g\n' | dipole points
! dipole points: standard input: the column sigma_s is missing; the header has model, sigma_a, R, eta, g; it needs sigma_a, sigma_s, g and eta, or medium and channel, or layers; and r unless --r is given; and may have model, moments and parameters
? 1

$ printf 'sigma_a,sigma_s,g,eta,r,r\n' | dipole points
! dipole points: standard input: the header has the column r twice: rename one
? 1

$ printf 'sigma_a,sigma_s,g,eta,r,cos_in,cos_in\n' | dipole points
! dipole points: standard input: the header has the column cos_in twice: rename one
? 1

$ printf '# a comment\n' | dipole points
# a comment
! dipole points: standard input: there is no header line; it names the columns: sigma_a, sigma_s, g, eta, r, if need be model, moments, medium, channel and parameters
? 1

## a comment
$ dipole points /nonexistent/rows.csv
! dipole points: /nonexistent/rows.csv: No such file or directory
? 1

$ dipole points .
! dipole points: .: Is a directory
? 1

$ printf 'sigma_a,sigma_s,g,eta,r\n0.01,1,0,1.4,2\n"0.01,1,0,1.4,2\n' | dipole points --model better --wanted R
sigma_a,sigma_s,g,eta,r,R,status
0.01,1,0,1.4,2,0.008922392411638412,ok
! dipole points: standard input: line 3: a quote is not closed
? 1

$ for name in evaluator evaluater tolerence Model sigma-a fit_form; do printf "sigma_a,sigma_s,g,eta,r,$name\n" | dipole points; done
! dipole points: standard input: the column evaluator is not read; the nearest is the option --evaluator, which holds for all rows: give it, and rename the column
! dipole points: standard input: the column evaluater is not read; the nearest is the option --evaluator, which holds for all rows: give it, and rename the column
! dipole points: standard input: the column tolerence is not read; the nearest that is read is tolerance: rename it
! dipole points: standard input: the column Model is not read; the nearest that is read is model: rename it
! dipole points: standard input: the column sigma-a is not read; the nearest that is read is sigma_a: rename it
! dipole points: standard input: the column fit_form is not read; the nearest that is read is fit_from: rename it
? 1

$ printf 'layers,sigma_a,sigma_s,g,eta,r\n"1,10,.8,1.4,.1 .1,10,.8,1.4",,,.8,,1\n' | dipole points --model better --wanted R; printf 'sigma_a,sigma_s,g,eta,r\n0.01,1,0,1.4,2,,\n' | dipole points --model better --wanted R; dipole points --wanted balance one.csv
layers,sigma_a,sigma_s,g,eta,r,R,status
"1,10,.8,1.4,.1 .1,10,.8,1.4",,,.8,,1,,g: its layers have theirs: leave the cell empty
sigma_a,sigma_s,g,eta,r,R,status
0.01,1,0,1.4,2,,"the row: 7 cells: allowed: 5, as many as in the header",,
! dipole points: standard input: 1 of 1 rows were bad: see the column status
! dipole points: standard input: 1 of 1 rows were bad: see the column status
! dipole points: --wanted balance: rows have no room for its shares; use dipole eval
! `dipole points --help` says more.
? 2

$ awk 'BEGIN { print "sigma_a,sigma_s,g,eta,r"; for (i = 0; i < 258; i++) print .01 + i / 1e4 ",1,.1,1.4,1" }' > many.csv; dipole points many.csv --wanted R --errors | tail -2; dipole eval --sigma-a .0357 --sigma-s 1 --g .1 --eta 1.4 --r 1 --wanted R --format csv | tail -1
0.0356,1,.1,1.4,1,0.015780067,2.998480261549287e-4,0,ok
0.0357,1,.1,1.4,1,0.015771737,2.998480261549287e-4,0,ok
transport,1,0.0357,1,0.1,1.4,1,0.015771745,3.2203793702233907e-4,0,lut,

## The longest row has 1 MiB. Rows before one that is longer come out.
$ for longer in 0 1; do (printf 'note,sigma_a,sigma_s,g,eta,r\n-,0.01,1,0,1.4,2\n'; head -c $((1048576 - 16 + longer)) /dev/zero | tr '\0' x; printf ',0.01,1,0,1.4,2\n') | dipole points --model better | tr -s x; done
note,sigma_a,sigma_s,g,eta,r,R,albedo,cdf,status
-,0.01,1,0,1.4,2,0.008922392411638412,0.605952712135344,0.37076385200174106,ok
x,0.01,1,0,1.4,2,0.008922392411638412,0.605952712135344,0.37076385200174106,ok
note,sigma_a,sigma_s,g,eta,r,R,albedo,cdf,status
-,0.01,1,0,1.4,2,0.008922392411638412,0.605952712135344,0.37076385200174106,ok
! dipole points: standard input: line 3: the row is longer than 1 MiB

## Many rows keep their order, and equal ones have equal values.
$ awk 'BEGIN { print "id,sigma_a,sigma_s,g,eta,r"; for (i = 0; i < 20000; i++) print i "," (i == 777 ? -1 : i % 7 / 10) ",1,0,1.4," i % 11 }' | dipole points --model better | awk -F, 'NR == 1 { next } $1 != NR - 2 || $NF != "ok" { print; next } { key = $2 " " $6; value = $7 "," $8 "," $9 } key in seen && seen[key] != value { print "not as before: " $0 } { seen[key] = value } END { print NR - 1 " rows, " length(seen) " values" }'
777,-1,1,0,1.4,7,,,,bad-value: sigma_a: allowed: 0 to 1e15 per mm
20000 rows, 77 values
! dipole points: standard input: 1 of 20000 rows were bad: see the column status

## More rows by themselves than may be outstanding: with derivatives, and those of a group that are wrong, each is asked for alone.
$ for a in .01 -1; do awk -v a=$a 'BEGIN { print "sigma_a,sigma_s,g,eta,r"; for (i = 1; i <= 9000; i++) print a ",1,0,1.4," i }' | dipole points --model better --wanted $([ $a = -1 ] && echo R || echo dR_dr) | awk -F, 'NR > 1 { if ($5 != NR - 1) print; count[$NF]++ } END { for (status in count) print count[status], status }'; done
9000 ok
9000 bad-value: sigma_a: allowed: 0 to 1e15 per mm
! dipole points: standard input: 9000 of 9000 rows were bad: see the column status
