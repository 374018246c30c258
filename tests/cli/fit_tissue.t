## dipole fit --unknown: what a tissue is made of, and what readings do not say.
$ dipole eval --tissue hbo2=56,hb=24,water=.6,fat=.3,a=1.9,b=1.2 --wavelengths 650:1000:50 --r 2,4,7,12 --evaluator f64 --format csv | awk -F, 'NR == 1 { for (i = 1; i <= NF; i++) c[$i] = i; print "wavelength_nm,r,R,error"; next } { print $c["wavelength_nm"] "," $c["r"] "," $c["R"] "," $c["R"] / 100 }' > bands.csv

$ dipole fit bands.csv --unknown hbo2,hb,water,fat,a,b
model transport, moments exact, haemoglobin prahl, g 0.9, eta 1.4, scale absolute

sample  unknown           value   error  numerical  status       chi2  readings  condition  sample is
------  --------------  -------  ------  ---------  ------  ---------  --------  ---------  ---------
1       hbo2_uM              56    0.66    1.3e-01  fitted  2.098e-07        32       29.8     fitted
1       hb_uM                24    0.42    7.2e-02  fitted  2.098e-07        32       29.8     fitted
1       water_fraction      0.6  0.0065    1.2e-03  fitted  2.098e-07        32       29.8     fitted
1       fat_fraction    0.29999   0.051    9.1e-03  fitted  2.098e-07        32       29.8     fitted
1       a_per_mm            1.9   0.033    5.7e-03  fitted  2.098e-07        32       29.8     fitted
1       b                   1.2   0.031    5.4e-03  fitted  2.098e-07        32       29.8     fitted
1       saturation          0.7  0.0045          -  fitted  2.098e-07        32       29.8     fitted
1       total_uM             80    0.76          -  fitted  2.098e-07        32       29.8     fitted

errors are standard errors, inf where a value has none; numerical: how far numerical errors of R may
shift a value; chi2 is the sum of the squares of (reading - fit) / error

$ sed '1s/$/,source_mm,detector_mm/; 2,$s/$/,.2,1/' bands.csv | dipole fit --unknown hbo2,hb=0:20,water,a,b --tissue fat=.3 --format csv
sample,unknown,value,error,numerical,status,scale,scale_error,chi2,readings,condition,sample_status
1,hbo2_uM,58.82467179265267,inf,0.11603239468869436,implausible,1,0,181.62844300467384,32,26.5405996284133,at-bound
1,hb_uM,20,inf,0.07255208785723129,at-bound,1,0,181.62844300467384,32,26.5405996284133,at-bound
1,water_fraction,0.6293598535005265,inf,0.0012373913910598616,implausible,1,0,181.62844300467384,32,26.5405996284133,at-bound
1,a_per_mm,2.2423999213575567,inf,0.007092450925352482,implausible,1,0,181.62844300467384,32,26.5405996284133,at-bound
1,b,1.497700298489102,inf,0.005454562012367755,implausible,1,0,181.62844300467384,32,26.5405996284133,at-bound
1,saturation,0.7462723339640441,inf,,at-bound,1,0,181.62844300467384,32,26.5405996284133,at-bound
1,total_uM,78.82467179265268,inf,,at-bound,1,0,181.62844300467384,32,26.5405996284133,at-bound
! dipole fit: standard input: 1 of 1 samples were not fitted whole: see the column status
? 3

$ head -9 bands.csv | dipole fit --unknown hbo2,hb,water,a,b --tissue fat=.3 --scale free
fat=.3, haemoglobin by prahl, model transport, moments exact, g 0.9, eta 1.4, scale free

sample  unknown         value  error  numerical        status  scale  its error       chi2  readings  condition     sample is
------  --------------  -----  -----  ---------  ------------  -----  ---------  ---------  --------  ---------  ------------
1       hbo2_uM             -    inf    1.2e+00  undetermined      1      0.011  2.031e-08         8        inf  undetermined
1       hb_uM               -    inf    6.6e-02  undetermined      1      0.011  2.031e-08         8        inf  undetermined
1       water_fraction      -    inf    1.2e-01  undetermined      1      0.011  2.031e-08         8        inf  undetermined
1       a_per_mm          1.9   0.18    1.6e-02        fitted      1      0.011  2.031e-08         8        inf  undetermined
1       b                 1.2   0.31    2.8e-02        fitted      1      0.011  2.031e-08         8        inf  undetermined
1       saturation          -    inf          -  undetermined      1      0.011  2.031e-08         8        inf  undetermined
1       total_uM            -    inf          -  undetermined      1      0.011  2.031e-08         8        inf  undetermined

errors are standard errors, inf where a value has none; numerical: how far numerical errors of R may
shift a value; chi2 is the sum of the squares of (reading - fit) / error
! dipole fit: standard input: 1 of 1 samples were not fitted whole: see the column status
? 3

$ dipole eval --tissue hbo2=56,hb=24,water=.6,fat=.3,a=1.9,b=1.2,g=0 --wavelengths 650:1000:50 --r 15,20,25 --mhz 100 --wanted R,phase,modulation --evaluator f64 --format csv | awk -F, 'NR == 1 { for (i = 1; i <= NF; i++) c[$i] = i; print "wavelength_nm,r,mhz,R,error,phase,phase_error"; next } { R = 7 * $c["R"] * $c["modulation"]; print $c["wavelength_nm"] "," $c["r"] ",100," R "," R / 100 "," $c["phase"] ",.2" }' > waves.csv

$ dipole fit waves.csv --unknown hbo2,hb,water,fat,a,b --tissue g=0 --scale free
g=0, haemoglobin by prahl, model transport, moments exact, g 0, eta 1.4, scale free

sample  unknown           value   error  numerical  status  scale  its error       chi2  readings  condition  sample is
------  --------------  -------  ------  ---------  ------  -----  ---------  ---------  --------  ---------  ---------
1       hbo2_uM              56    0.34    4.7e-02  fitted      7      0.063  6.241e-06        48       11.3     fitted
1       hb_uM                24    0.15    2.2e-02  fitted      7      0.063  6.241e-06        48       11.3     fitted
1       water_fraction      0.6  0.0042    5.9e-04  fitted      7      0.063  6.241e-06        48       11.3     fitted
1       fat_fraction    0.29999    0.02    2.1e-03  fitted      7      0.063  6.241e-06        48       11.3     fitted
1       a_per_mm            1.9   0.015    2.1e-03  fitted      7      0.063  6.241e-06        48       11.3     fitted
1       b                   1.2   0.017    2.4e-03  fitted      7      0.063  6.241e-06        48       11.3     fitted
1       saturation          0.7   0.002          -  fitted      7      0.063  6.241e-06        48       11.3     fitted
1       total_uM             80    0.35          -  fitted      7      0.063  6.241e-06        48       11.3     fitted

errors are standard errors, inf where a value has none; numerical: how far numerical errors of R may
shift a value; chi2 is the sum of the squares of (reading - fit) / error

$ cut -d, -f1-6 waves.csv | dipole fit --unknown hbo2 --tissue a=1,b=1
! dipole fit: standard input: the column phase_error is missing; the header has wavelength_nm, r, mhz, R, error, phase; it needs wavelength_nm, r (mm) or f (1/mm), R and error for --unknown, and may have sample, source_mm, detector_mm, relative_error; of modulated light mhz, phase (degrees), phase_error, modulation, modulation_error
? 1

$ sed 1s/R,error/x,y/ waves.csv | dipole fit --unknown hbo2 --tissue a=1,b=1,g=0 --scale free
! dipole fit: sample 1: bad-value: scale: allowed: absolute: phases and modulations have no factor (--scale)
? 1

$ head -14 bands.csv | dipole fit --unknown hbo2,hb --tissue a=1,b=1
! dipole fit: standard input: sample 1: each wavelength needs one reading at each of the same places: see 800 nm, line 14
? 1

$ dipole fit bands.csv --unknown hbo2 --tissue b=1
! dipole fit: sample 1: bad-value: a_per_mm: allowed: 0 to 1000: it has to be given
? 1

$ dipole fit bands.csv --unknown hbo2=3,a
! dipole fit: --unknown hbo2=3: give hbo2, or limits as hbo2=LOW:HIGH
! `dipole fit --help` says more.
? 2

$ dipole fit bands.csv --unknown hbo2,cco
! dipole fit: --unknown: 'cco' is no property; they are hbo2_uM, hb_uM, water_fraction, fat_fraction, melanin_fraction, bilirubin_uM, carotene_uM, cco_ox_uM, cco_red_uM, blood_fraction, bloodless_fraction, a_per_mm, b, rayleigh_share, g, eta, vessel_radius_mm, thickness_mm
! `dipole fit --help` says more.
? 2

$ dipole fit bands.csv --unknown hbo2 --eta 1.4
! dipole fit: --unknown: leave --layer, --reference, --g, --eta, --thickness and --plot out; g=X and eta=X are properties of --tissue
! `dipole fit --help` says more.
? 2

$ dipole fit bands.csv --tissue liver
! dipole fit: --tissue, --haemoglobin and --maps are for what --unknown names: give it, too
! `dipole fit --help` says more.
? 2

$ cut -d, -f1,3- bands.csv | dipole fit --unknown hbo2 --tissue a=1,b=1
! dipole fit: standard input: the column r or f (one of both) is missing; the header has wavelength_nm, R, error; it needs wavelength_nm, r (mm) or f (1/mm), R and error for --unknown, and may have sample, source_mm, detector_mm, relative_error; of modulated light mhz, phase (degrees), phase_error, modulation, modulation_error
? 1

## Images of several bands become maps; here of two pixels, the second without light.
$ dipole eval --tissue hbo2=56,hb=24,water=.6,a=1.9,b=1.2 --wavelengths 660,735,810,850 --f 0,.1 --wanted R_f --evaluator f64 --format csv | perl -ne 'if ($. == 1) { chomp; @n = split /,/; $at{$n[$_]} = $_ for 0 .. $#n; print "wavelength_nm,f,image,relative_error\n" } else { @c = split /,/; ($nm, $f, $R) = @c[@at{"wavelength_nm", "f", "R_f"}]; open $o, ">", "$nm-$f.pfm"; print $o "Pf\n2 1\n-1\n", pack "f<2", $R, 0; print "$nm,$f,$nm-$f.pfm,.01\n" }' > images.csv; cat images.csv
wavelength_nm,f,image,relative_error
660,0,660-0.pfm,.01
660,0.1,660-0.1.pfm,.01
735,0,735-0.pfm,.01
735,0.1,735-0.1.pfm,.01
810,0,810-0.pfm,.01
810,0.1,810-0.1.pfm,.01
850,0,850-0.pfm,.01
850,0.1,850-0.1.pfm,.01

$ dipole fit images.csv --unknown hbo2,hb,a,b --tissue water=.6 --maps out.pfm; for i in out.*.pfm; do perl -e 'local $/; $_ = <>; s/^Pf\n2 1\n-1.0\n//; printf "%s %.4g %.4g\n", $ARGV, unpack "f<2", $_' $i; done
water=.6, haemoglobin by prahl, model transport, moments exact, g 0.9, eta 1.4, scale absolute

unknown     pixels  fitted
----------  ------  ------
hbo2_uM          2       1
hb_uM            2       1
a_per_mm         2       1
b                2       1
saturation       2       1
total_uM         2       1
out.a_per_mm.pfm 1.9 NaN
out.a_per_mm_error.pfm 0.05323 NaN
out.b.pfm 1.2 NaN
out.b_error.pfm 0.06304 NaN
out.chi2.pfm 2.033e-08 NaN
out.hb_uM.pfm 24 NaN
out.hb_uM_error.pfm 1.301 NaN
out.hbo2_uM.pfm 56 NaN
out.hbo2_uM_error.pfm 2.641 NaN
out.saturation.pfm 0.7 NaN
out.saturation_error.pfm 0.01903 NaN
out.status.pfm 1 6
out.total_uM.pfm 80 NaN
out.total_uM_error.pfm 2.137 NaN
! dipole fit: images.csv: 1 of 2 pixels were not fitted whole: what is not fitted is NaN; the map status has the ids of `dipole info`

$ for i in [678]*.pfm; do perl -e 'local $/; $_ = <>; /^Pf\n2 1\n-1\n(....)/s or die; open $o, ">", "wide-$ARGV"; print $o "Pf\n60 1\n-1\n", $1 x 60' $i; done; sed 's/,[^,]*pfm/,wide-&/;s/-,/-/' images.csv > wide.csv; for bytes in 4096 1048576; do DIPOLED_MAX_PART_BYTES=$bytes dipole fit wide.csv --unknown hbo2,hb,a,b --tissue water=.6 --maps $bytes.pfm > $bytes.txt; done; cmp 4096.txt 1048576.txt; cmp 4096.hbo2_uM.pfm 1048576.hbo2_uM.pfm; tail -1 4096.txt
total_uM        60      60

$ dipole fit images.csv --unknown hbo2,hb --maps out.png; dipole fit images.csv --maps out.pfm; sed s/850-0.pfm/nothing.pfm/ images.csv | dipole fit --unknown hbo2 --maps out.pfm; cut -d, -f1-3 images.csv | dipole fit --unknown hbo2 --maps out.pfm; sed 's/image/image,R/;s/pfm/pfm,1/' images.csv | dipole fit --unknown hbo2 --maps out.pfm; printf 'Pf\n1 1\n-1\n0000' > 850-0.pfm; dipole fit images.csv --unknown hbo2 --tissue a=1,b=1 --maps out.pfm
! dipole fit: --maps: out.png does not end with .pfm
! `dipole fit --help` says more.
! dipole fit: --tissue, --haemoglobin and --maps are for what --unknown names: give it, too
! `dipole fit --help` says more.
! dipole fit: nothing.pfm: No such file or directory
! dipole fit: standard input: the column error is missing; the header has wavelength_nm, f, image; it needs wavelength_nm, r (mm) or f (1/mm), image (a file) and error, or relative_error, for --maps, and may have source_mm, detector_mm, mhz
! dipole fit: standard input: the column R is not read with --maps
! dipole fit: 850-0.pfm: all images have to be grey, and of the size of 660-0.pfm, 2 x 1
? 1

$ head -2 images.csv | dipole fit --unknown a --tissue water=.6,b=1 --maps $(printf %05000d 0).pfm
! dipole fit: 0000...chi2.pfm: File name too long
? 1

## Which line is wrong.
$ sed '4s/.*/650,7,0,0/' bands.csv > zero.csv; dipole fit zero.csv --unknown hbo2,hb --tissue a=1.9,b=1.2 --format csv; (cat bands.csv; sed -n 9p bands.csv) | dipole fit --unknown hbo2 --tissue a=1,b=1; sed 's/^950,/1010,/' bands.csv | dipole fit --unknown hbo2 --tissue a=1,b=1
sample,unknown,value,error,numerical,status,scale,scale_error,chi2,readings,condition,sample_status
1,hbo2_uM,,,,refused,,,,32,,refused
1,hb_uM,,,,refused,,,,32,,refused
! dipole fit: sample 1: line 4: its error must be above 0, and finite
! dipole fit: zero.csv: 1 of 1 samples were not fitted whole: see the column status
! dipole fit: standard input: sample 1: each wavelength needs one reading at each of the same places: see 700 nm, line 34
! dipole fit: sample 1: 1010 nm: bad-value: wavelength: allowed: 250 to 1000 nm, the range of HBO2 (Prahl 1998, omlc.org)
? 1

$ sed '1s/error/relative_error/;2,$s/[^,]*$/.01/' bands.csv | dipole fit --unknown hbo2,hb,water,a,b --tissue fat=.3 --format csv | cut -d, -f1-4
sample,unknown,value,error
1,hbo2_uM,55.99990143012229,0.5509185736524062
1,hb_uM,23.999977826321444,0.40882379585709955
1,water_fraction,0.6000012553434728,0.006384522005323616
1,a_per_mm,1.9000024536527123,0.03170354561812928
1,b,1.1999999198421833,0.02951666314913326
1,saturation,0.699999824382381,0.004485935480328407
1,total_uM,79.99987925644373,0.6143461341275079

$ dipole fit bands.csv --unknown hbo2 --tissue a=1 --tissue b=1; dipole fit bands.csv --unknown $(printf 'hb,%.0s' $(seq 40))hb --tissue a=1,b=1; dipole fit bands.csv --unknown hbo2 --gamma 1.5 --tissue a=1,b=1; dipole fit bands.csv --unknown hbo2,hb,water,a,b --tissue fat=.3 --detector-na .3 --format csv | cut -d, -f2,3,5
unknown,value,numerical
hbo2_uM,0,0.03744107892318969
hb_uM,0,0.018866539380163392
water_fraction,0,2.9988195282491684e-4
a_per_mm,1.2352302053782345,0.0084652771649367
b,1.1267542213233877,0.01243248833476743
! dipole fit: --tissue: a fit of a tissue has no layers: give one
! `dipole fit --help` says more.
! dipole fit: --unknown: too many
! `dipole fit --help` says more.
! dipole fit: --unknown: no parameter but --detector-na goes with it
! `dipole fit --help` says more.
! dipole fit: bands.csv: 1 of 1 samples were not fitted whole: see the column status
