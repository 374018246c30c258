## dipole eval --mci: MCML's input files. What the solver's grids change is "...".
$ printf '# van de Hulst\n1.0 # version\n2\n\nslab.mco A\n1000 # photons\n.01 .1\n10 2 1\n1\n1\n1 2 18 .75 .1 # mm: .2 1.8 .75 1\n1\ndeep.mco A\n1000\n.01 .05\n10 1 1\n2\n1\n1.4 10 1 0 .01\n1.4 1 9 0 1e8\n1\n' > two.mci

$ dipole eval --mci two.mci --tolerance 1
run       quantity  layer  from    to        value      error
                             cm    cm    1, 1/cm^2  1, 1/cm^2
--------  --------  -----  ----  ----  -----------  ---------
slab.mco  Rsp                          0.00000e+00    0.0e+00
slab.mco  Rd                           9.73946e-02 ...
slab.mco  Tt                           6.60958e-01 ...
slab.mco  A             1              2.41648e-01 ...
slab.mco  Rd_r                0   0.1  1.86...
slab.mco  Rd_r              0.1   0.2  2.56...
slab.mco  Tt_r                0   0.1  1.91...
slab.mco  Tt_r              0.1   0.2  4.6...
deep.mco  Rsp                          2.77778e-02    0.0e+00
deep.mco  Rd                           1.75847e-01 ...
deep.mco  Tt                           0.00000e+00 ...
deep.mco  A             1              2.08883e-01 ...
deep.mco  A             2              5.87493e-01 ...
deep.mco  Rd_r                0  0.05  7.5...

## A ring of hundreds of mean free paths holds all light.
$ printf '1.0\n1\na A\n9\n.01 500\n10 1 1\n1\n1\n1.4 1 9 0 1e8\n1\n' > wide.mci; dipole eval --mci wide.mci --tolerance 1 --format csv | awk -F, '$2 == "Rd" { all = $6 } $2 == "Rd_r" { ring = $6 * 3.14159265 * 500 ^ 2; error = $7 * 3.14159265 * 500 ^ 2 } END { off = ring - all; print (off < 0 ? -off : off) < error }'
1

## Only ratios of refractive indices count.
$ for n in 1 2; do printf "1.0\n1\na A\n9\n.1 .1\n1 2 1\n1\n$n\n$((14 * n))e-1 1 10 .8 .1\n$((12 * n))e-1\n" > one.mci; dipole eval --mci one.mci --tolerance 1 --format csv; done | sort | uniq -c
      2 a,A,1,,,0.1460178099484459,...
      2 a,Rd,,,,0.030124724891996274,...
      2 a,Rd_r,,0,0.1,0.4245...
      2 a,Rd_r,,0.1,0.2,0.0509...
      2 a,Rsp,,,,0.02777777777777779,0
      2 a,Tt,,,,0.7960796873817799,...
      2 a,Tt_r,,0,0.1,23.8437...
      2 a,Tt_r,,0.1,0.2,0.1737...
      2 run,quantity,layer,from,to,value,error

$ dipole eval --mci two.mci --medium skin1 || dipole eval --r 1 --mci two.mci --tolerance 0.1
! dipole eval: --mci evaluates what its file says: leave --medium out
! `dipole eval --help` says more.
! dipole eval: --mci evaluates what its file says: leave --r out
! `dipole eval --help` says more.
? 2

$ dipole eval --mci none.mci
! dipole eval: none.mci: No such file or directory
? 1

$ printf 'mcmli2.0\n' > new.mci; dipole eval --mci new.mci
! dipole eval: new.mci:1: 'mcmli2.0': expected 1.0, the version of MCML's input files
? 1

$ sed 's/ .75 .1//' two.mci > short.mci; dipole eval --mci short.mci
! dipole eval: short.mci:11: '1 2 18 ': expected n, mua, mus, g and d of a layer, in cm
? 1

$ sed 's/^1 2 18 .75 .1/& 9/' two.mci > more.mci; dipole eval --mci more.mci
! dipole eval: more.mci:11: '1 2 18 .75 .1 9 ': expected n, mua, mus, g and d of a layer, in cm
? 1

$ sed 's/^10 2 1/10 2e9 1/' two.mci > long.mci; dipole eval --mci long.mci
! dipole eval: long.mci:10: give a dr above 0, and 1 to 1e5 of them
? 1

$ sed '3s/2/1/; 5,12d; s/1.4 10 1/1.4 0 0/' two.mci > clear.mci; dipole eval --mci clear.mci --tolerance 0.1
! dipole eval: clear.mci: run deep.mco: layer 1: sigma_s: allowed: not negative, finite; not 0 where sigma_a is 0
? 1
