## What is wrong with a CSV is named.
$ for text in 'x,y,z;power\n0,0,0;1\n' '# made\nx y z power\n0 0 0 1\n' 'x;y;z;power\n0;0;0;1,5\n' 'x,y,z,power\n0,0205,0,1\n' 'x,y,z,power\n0,0,0,1\n#0,0,0,1\n' 'x,y,z,power\n0,0,0,1\n0,"0,0,2\n0,0,1,1\n' 'x,y,z,power\r0,0,0,1\r0,zero,0,1\r' 'x\ty\tz\tpower\n0\t0\t0\t1,234\n' 'x,y,z,power\n0,0,0,1,5\n' 'x,y,z,power\n0,"0"1,0,1\n'; do printf "$text" > p.csv; dipole gather p.csv p.csv --sigma-a 1 --sigma-s 1; done
! dipole gather: p.csv: line 1: the header has commas and semicolons: separate its columns by one of them
! dipole gather: p.csv: line 2: the header is one cell: separate its columns by commas, semicolons or tabs
! dipole gather: p.csv: line 2: power: '1,5' is no number: write a decimal point
! dipole gather: p.csv: line 2: y: '0205' is no number: write a decimal point
! dipole gather: p.csv: line 3: x: '#0' is no number: below the header, lines with several cells are no comments
! dipole gather: p.csv: line 3: a quote is not closed
! dipole gather: p.csv: line 3: y: 'zero' is no number
! dipole gather: p.csv: line 2: power: '1,234' is no number: write a decimal point
! dipole gather: p.csv: line 2: more cells than in the header: numbers have a decimal point
! dipole gather: p.csv: line 2: text stands after a closing quote
? 1

$ printf '#\nx,y,z,power\n0,0,0,1\n' | iconv -t UTF-16 > p.csv; dipole gather p.csv p.csv --sigma-a 1 --sigma-s 1
! dipole gather: p.csv: line 1: the header has zero bytes, as UTF-16 has: save the file as UTF-8, or convert it by iconv -f UTF-16 -t UTF-8
? 1

$ (printf 'x,y,z,power\n0,0,"0,1'; head -c 1048576 /dev/zero | tr '\0' 1) > p.csv; dipole gather p.csv p.csv --sigma-a 1 --sigma-s 1
! dipole gather: p.csv: line 2: a quote is not closed within 1 MiB
? 1

$ (printf 'x,y,z,power\n0,0,0,'; head -c 1048576 /dev/zero | tr '\0' 1) > p.csv; dipole gather p.csv p.csv --sigma-a 1 --sigma-s 1
! dipole gather: p.csv: line 2: the row is longer than 1 MiB
? 1

## Samples whose names start with a hash vanish from no file, whatever stands above the header.
$ for above in '' '# by hand\n' '#'; do printf "${above}sample,r,R,error\n#1,1,.0234,.0005\n#1,2,.00787,.0002\n#1,4,.00159,.00003\na,1,.0234,.0005\na,2,.00787,.0002\n" | dipole fit --model better --eta 1.4 --format csv | cut -d, -f1,17; done
sample,status
"#1",fitted
a,fitted
sample,status
"#1",fitted
a,fitted
sample,status
"#1",fitted
a,fitted

$ printf 'sample,r,R,error,,\na,1,.0234,.0005,,\na,2,.00787,.0002\na,4,.00159,.00003\n' | dipole fit --model better --eta 1.4 --format csv | cut -d, -f1,17
sample,status
a,fitted

## Line ends, a byte order mark, cells in quotes and bytes that are no text stay as they are.
$ printf 'sigma_a,sigma_s,g,eta,r\r\n0.01,1,0,1.4,2\r\n\r\n0.01,1,0,1.4,2\n' | dipole points | cat -A
sigma_a,sigma_s,g,eta,r,R,albedo,cdf,status^M$
0.01,1,0,1.4,2,0.0076295505,0.6222119489494612,0.44686064,ok^M$
^M$
0.01,1,0,1.4,2,0.0076295505,0.6222119489494612,0.44686064,ok$

$ printf '\357\273\277my note,sigma_a,sigma_s,g,eta,r\n"two\nlines, # and ""quotes""",0.01,1,0,1.4,2\n"",0.01,1,0,1.4,2\n\377\000\376,0.01,1,0,1.4,2\n' | dipole points | cat -A
M-oM-;M-?my note,sigma_a,sigma_s,g,eta,r,R,albedo,cdf,status$
"two$
lines, # and ""quotes""",0.01,1,0,1.4,2,0.0076295505,0.6222119489494612,0.44686064,ok$
"",0.01,1,0,1.4,2,0.0076295505,0.6222119489494612,0.44686064,ok$
M-^?^@M-~,0.01,1,0,1.4,2,0.0076295505,0.6222119489494612,0.44686064,ok$

## Forms of CSV that cannot be misunderstood, which all commands read alike: the first is the plain one.
$ printf 'sigma_a,sigma_s,g,eta,r\n0.01,1,0,1.4,2\n0.5,1.25,0,1.4,2\n' > rows; printf 'sample,r,R,error\na,1,.0234,.0005\na,2,.00787,.0002\na,4,.00159,.00003\n' > readings; printf 'x,y,z,power\n0,0,0,1.5\n0,2,0,0.5\n' > p; sed s/2/3/ p > q; for form in cat "sed 's/,/ ,\t /g'" "sed 's/[^,]*/ \"&\"/g'" "tr , ';'" "sed 's/,/ \t/g'" "tr '\n' '\r'" "(printf '\r\n'; sed 's/$/\r/')" "(printf '# by hand, twice\n# '; cat)" "(printf '#'; tr , '\t')" "(printf '# x,y\n#'; sed '1a # in mm\n\n#')" "(echo '#1'; sed 'a # so it is\n'; printf '#')" "(printf '\357\273\277sep=;\r\n'; tr , ';')" "(printf '\357\273\277#'; sed 's/,/; /g' | tr '\n' '\r')"; do for file in rows readings p q; do eval "$form" < $file > $file.form; done; dipole points --model better rows.form | tr -d '" ' | tr '\r' '\n' | sed 's/[,;]\t/,/g; s/[;\t]/,/g' | grep '^0' > found; dipole fit --model better --eta 1.4 --format csv readings.form | cut -d, -f1-5,17 >> found; dipole gather p.form q.form --sigma-a .01 --sigma-s 1 --model better --format csv >> found; [ "$form" = cat ] && cat found && cp found plain; printf '%s\n' "$form"; diff plain found; done
0.01,1,0,1.4,2,0.008922392411638412,0.605952712135344,0.37076385200174106,ok
0.5,1.25,0,1.4,2,6.394823695552765e-4,0.07234213178114271,0.9249316622989945,ok
sample,sigma_a,sigma_s_prime,sigma_a_error,sigma_s_prime_error,status
a,0.030032583570163054,1.2023918589517062,9.484325177021148e-4,0.025222010371669514,fitted
x,y,z,M_1,bound,numerical_error_1,model_error_1
0,0,0,0.08387405658140779,0,8.173521029507774e-5,0.9906618854846919
0,3,0,0.019654877483844757,0,8.173521029507774e-5,0.9906618854846919
cat
sed 's/,/ ,\t /g'
sed 's/[^,]*/ "&"/g'
tr , ';'
sed 's/,/ \t/g'
tr '\n' '\r'
(printf '\r\n'; sed 's/$/\r/')
(printf '# by hand, twice\n# '; cat)
(printf '#'; tr , '\t')
(printf '# x,y\n#'; sed '1a # in mm\n\n#')
(echo '#1'; sed 'a # so it is\n'; printf '#')
(printf '\357\273\277sep=;\r\n'; tr , ';')
(printf '\357\273\277#'; sed 's/,/; /g' | tr '\n' '\r')
