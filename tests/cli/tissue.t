## dipole tissue: what is there, and coefficients.
$ dipole tissue --format csv | grep -E '^(kind|tissue,liver|property,hb|spectrum,(hb|water))'
kind,name,about
tissue,liver,"scattering: Jacques 2013 T1 row 28; amounts: VTS"
property,hbo2_uM,"oxyhaemoglobin, uM of tetramer; whole blood has 2326 uM (0 to 10000)"
property,hb_uM,"deoxyhaemoglobin, uM of tetramer (0 to 10000)"
spectrum,hbo2_uM,"250 to 1000 nm: Prahl 1998, omlc.org (prahl)"
spectrum,hb_uM,"250 to 1000 nm: Prahl 1998, omlc.org (prahl)"
spectrum,hbo2_uM,"650 to 1042 nm: Cope 1991, UCL (ucl)"
spectrum,hb_uM,"650 to 1042 nm: Cope 1991, UCL (ucl)"
spectrum,water_fraction,"250 to 1300 nm: Segelstein 1981; Kou 1993 from 670 nm"

$ dipole tissue --tissue liver --wavelengths 650,850:1000:75
liver, haemoglobin by prahl

wavelength    sigma_a  sigma_s    g  eta  sigma_s'
        nm       1/mm     1/mm                1/mm
----------  ---------  -------  ---  ---  --------
       650  0.0677889   7.6549  0.9  1.4   0.76549
       850    0.04438  6.48717  0.9  1.4  0.648717
       925  0.0558537   6.1574  0.9  1.4   0.61574
      1000  0.0678593  5.86823  0.9  1.4  0.586823

$ dipole tissue --tissue hbo2=80,a=2,b=1,rayleigh=.25,vessel_radius=.01 --wavelengths 542 --format json | grep -E 'haemo|nm.*: 542'
  "haemoglobin": "prahl",
    {"wavelength_nm": 542, "sigma_a": 0.7479821901859662, "sigma_s": 17.458841410027716, "g": 0.9, "eta": 1.4, "sigma_s_prime": 1.7458841410027712}

$ dipole tissue --tissue epidermis,thickness=.06 --wavelengths 500:500:1 --format csv
wavelength_nm,sigma_a,sigma_s,g,eta,thickness,sigma_s_prime
500,0.6670717348120088,68.70000000000002,0.9,1.4,0.06,6.87

$ dipole tissue --tissue epidermis,thickness=.06 --tissue dermis --wavelengths 500,600 --format csv
wavelength_nm,layers
500,"0.667071735,68.7,0.9,1.4,0.06 0.0226221508,45.3,0.9,1.4"
600,"0.379915975,55.5939216,0.9,1.4,0.06 0.0111709447,35.7928295,0.9,1.4"

## Values of tissues: rows have wavelengths, and answers name the table of haemoglobin.
$ dipole eval --tissue hbo2=56,hb=24,water=.65,melanin=.001 --scatter 4.6,1.42 --wavelengths 660,850 --haemoglobin ucl --r 1,5 --model better
hbo2=56,hb=24,water=.65,melanin=.001, haemoglobin by ucl, moments exact, R in 1/mm^2 per unit of power that entered

                better      better
wavelength      R 1 mm      R 5 mm
        nm      1/mm^2      1/mm^2
----------  ----------  ----------
       660  3.6564e-02  1.6156e-04
       850  3.4591e-02  4.2713e-04

                                                                          R            R           albedo       albedo
wavelength   model    sigma_a  sigma_s    g  eta    albedo  numerical error  model error  numerical error  model error  evaluator       notes
        nm               1/mm     1/mm                   1
----------  ------  ---------  -------  ---  ---  --------  ---------------  -----------  ---------------  -----------  ---------  ----------
       660  better  0.0461254  31.0129  0.9  1.4  0.544942          8.0e-15      2.4e-02          2.1e-15      3.4e-02        f64  similarity
       850  better  0.0325848  21.6531  0.9  1.4  0.543068          6.2e-15      2.7e-02          2.1e-15      3.4e-02        f64  similarity
numerical error: at most, against the model's formula, at r = 1 to 5 mm
model error: the largest, of the model against radiative transport
errors are relative, but of ln R, its derivatives, paths and modulated light absolute, as the
cdf's model error is, and of R_f over the albedo
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.972222 (eta 1.4)
note: similarity: g is not 0: the model uses isotropic scattering with sigma_s (1 - g)

$ dipole eval --tissue liver,g=.8 --wavelengths 650:850:200 --r 1,5 --model better --format csv
wavelength_nm,model,sigma_a,sigma_s,g,eta,r,R,albedo,numerical_error,model_error,numerical_error_R,model_error_R,numerical_error_albedo,model_error_albedo,evaluator,notes
650,better,0.06778891299534671,3.827449466042974,0.8,1.4,1,0.011851325533230012,0.24731734271798314,3.3234625063208483e-15,0.1125884614771322,3.3234625063208483e-15,0.06609698764347108,2.6202577570812305e-15,0.1125884614771322,f64,similarity
650,better,0.06778891299534671,3.827449466042974,0.8,1.4,5,4.851319832982741e-4,0.24731734271798314,6.13628150327932e-15,0.1125884614771322,6.13628150327932e-15,0.06609698764347108,2.6202577570812305e-15,0.1125884614771322,f64,similarity
850,better,0.04437997698683253,3.243586836792913,0.8,1.4,1,0.010488345869371071,0.28826722546724287,3.0542424206612682e-15,0.09697144174930307,3.0542424206612682e-15,0.057443671197213636,2.531118865062203e-15,0.09697144174930307,f64,similarity
850,better,0.04437997698683253,3.243586836792913,0.8,1.4,5,7.154708245658773e-4,0.28826722546724287,5.146736643057529e-15,0.09697144174930307,5.146736643057529e-15,0.057443671197213636,2.531118865062203e-15,0.09697144174930307,f64,similarity

$ dipole eval --tissue liver --wavelengths 500:640:2 --r 1 --model classical,better --format csv | cut -d, -f1-4,8 | tail -2; dipole eval --tissue liver --wavelengths 638,640 --r 1 --model classical,better --format csv | cut -d, -f1-4,8 | tail -2
638,better,0.08140738702781918,7.743416924033975,0.011369780444428148
640,better,0.07893162850179476,7.728477700544661,0.01145541597361848
638,better,0.08140738702781918,7.743416924033975,0.011369780444428148
640,better,0.07893162850179476,7.728477700544661,0.01145541597361848

$ dipole mc --tissue liver --wavelengths 650,850 --photons 4096 | head -1
liver, haemoglobin by prahl, Monte Carlo, ended by photons, photons 4096, error of the total R inf, largest error of a ring inf

$ dipole plot --tissue liver --wavelengths 650,850 --model better --plot x.svg; grep -o "liver, haemoglobin by prahl\|better, [0-9]* nm" x.svg
liver, haemoglobin by prahl
better, 650 nm
better, 850 nm

## What is wrong.
$ for one in lever liver,c=3 liver,fat adult-head liver,fat=2; do dipole tissue --tissue $one --wavelengths 650 || echo $?; done
2
2
2
1
1
! dipole tissue: --tissue: 'lever' is unknown; this daemon has skin, epidermis, dermis, breast, breast-tumour, brain, white-matter, liver, muscle, prostate, adult-head, forearm, subcutis. Is it liver?
! `dipole tissue --help` says more.
! dipole tissue: --tissue liver,c=3: 'c' is no property; they are hbo2_uM, hb_uM, water_fraction, fat_fraction, melanin_fraction, bilirubin_uM, carotene_uM, cco_ox_uM, cco_red_uM, blood_fraction, bloodless_fraction, a_per_mm, b, rayleigh_share, g, eta, vessel_radius_mm, thickness_mm
! `dipole tissue --help` says more.
! dipole tissue: --tissue liver,fat: give fat=X, a number
! `dipole tissue --help` says more.
! dipole tissue: --tissue adult-head: bad-value: a_per_mm: allowed: 0 to 1000: it has to be given
! dipole tissue: --tissue liver,fat=2: bad-value: fat_fraction: allowed: 0 to 1

$ for one in 650,1200 850:650:5 650:850:0 650:850:-1 650:850 400:1300:.5; do dipole tissue --tissue liver --wavelengths $one || echo $?; done
1
2
2
2
2
2
! dipole tissue: --tissue liver: bad-value: wavelength: allowed: 250 to 1000 nm, the range of HBO2 (Prahl 1998, omlc.org) (--wavelengths)
! dipole tissue: --wavelengths: '850:650:5' is no wavelength in nm, and no FROM:TO:STEP as 450:1000:5
! `dipole tissue --help` says more.
! dipole tissue: --wavelengths: '650:850:0' is no wavelength in nm, and no FROM:TO:STEP as 450:1000:5
! `dipole tissue --help` says more.
! dipole tissue: --wavelengths: '650:850:-1' is no wavelength in nm, and no FROM:TO:STEP as 450:1000:5
! `dipole tissue --help` says more.
! dipole tissue: --wavelengths: '650:850' is no wavelength in nm, and no FROM:TO:STEP as 450:1000:5
! `dipole tissue --help` says more.
! dipole tissue: --wavelengths: give at most 1024
! `dipole tissue --help` says more.

$ dipole tissue --tissue liver || dipole eval --tissue liver --wavelengths 650 --g .8 --r 1 || dipole eval --medium skin1 --wavelengths 650 --r 1 || dipole mc --medium skin1 --scatter 1,2 || dipole tissue --haemoglobin ucl
! dipole tissue: --tissue needs --wavelengths, as 650,850 or 450:1000:5
! `dipole tissue --help` says more.
! dipole eval: --tissue gives the medium whole: leave --medium, --channel, --sigma-a, --sigma-s, --g, --eta, --thickness and --layer out; g=X, eta=X and thickness=MM are properties
! `dipole eval --help` says more.
! dipole eval: --wavelengths, --scatter and --haemoglobin are those of a tissue: give --tissue, too
! `dipole eval --help` says more.
! dipole mc: --wavelengths, --scatter and --haemoglobin are those of a tissue: give --tissue, too
! `dipole mc --help` says more.
! dipole tissue: --wavelengths, --scatter and --haemoglobin are those of a tissue: give --tissue, too
! `dipole tissue --help` says more.
? 2

$ for one in 650:900 650:900:0:1 650:x:5; do dipole tissue --tissue liver --wavelengths $one || echo $?; done; dipole tissue $(for i in 1 2 3 4 5 6 7 8 9; do echo --tissue liver; done) --wavelengths 650; dipole tissue --tissue liver --scatter 1 --wavelengths 650; dipole tissue --tissue epidermis --tissue dermis --wavelengths 650; dipole tissue --tissue $(printf 'g=.8,%.0s' $(seq 30))g=.8 --wavelengths 650
2
2
2
! dipole tissue: --wavelengths: '650:900' is no wavelength in nm, and no FROM:TO:STEP as 450:1000:5
! `dipole tissue --help` says more.
! dipole tissue: --wavelengths: '650:900:0:1' is no wavelength in nm, and no FROM:TO:STEP as 450:1000:5
! `dipole tissue --help` says more.
! dipole tissue: --wavelengths: '650:x:5' is no wavelength in nm, and no FROM:TO:STEP as 450:1000:5
! `dipole tissue --help` says more.
! dipole tissue: --tissue: 9 layers: give at most 8
! `dipole tissue --help` says more.
! dipole tissue: --scatter: give A,B or A,B,SHARE, as 4.6,1.42
! `dipole tissue --help` says more.
! dipole tissue: --tissue epidermis: only the last layer may be a half space: add thickness=MM
! `dipole tissue --help` says more.
! dipole tissue: --tissue g=.8,g=.8,g=.8,g=.8,g=.8,g=.8,g=.8,g=.8,g=.8,g=.8,g=.8,g=.8,g=.8,g=.8,g=.8,g=.8,: bad-value: parameter: allowed: each at most once
? 1
