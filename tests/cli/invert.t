## dipole invert: media with given albedos.
$ dipole invert --albedo 0.25,0.75 --mean-free-path 1.5 --model better
model better, moments exact, given mean-free-path, = 1 / sigma_t', albedos from 7.64042e-62, to 1

channel  albedo  mean-free-path        sigma_a       +-      sigma_s       +-     sigma_s'  g  eta  its albedo  model error  status
         wanted              mm           1/mm     1/mm         1/mm     1/mm         1/mm
-------  ------  --------------  -------------  -------  -----------  -------  -----------  -  ---  ----------  -----------  ------
1          0.25             1.5   0.0641838214  4.9e-16  0.602482845  4.3e-15  0.602482845  0  1.3        0.25         0.16      ok
2          0.75             1.5  0.00280860178  4.3e-17  0.663858065  4.7e-15  0.663858065  0  1.3        0.75         0.01      ok
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.982987 (eta 1.3)

$ dipole invert --albedo 0.25,0.75 --mean-free-path 1,2 --g 0.8 --eta 1.4 --model better --format csv
model,channel,wanted_albedo,given,length,sigma_a,sigma_a_error,sigma_s,sigma_s_error,g,eta,albedo,albedo_model_error,status
better,1,0.25,mean-free-path,1,0.08006372314328833,5.688869687737134e-16,4.599681384283559,3.268270194413645e-14,0.8,1.4,0.25000000000000006,0.11150159047869569,ok
better,2,0.75,mean-free-path,2,0.001605803268234967,2.688821387764051e-17,2.4919709836588253,1.7706518801637296e-14,0.8,1.4,0.7499999999999999,0.009670642264622656,ok

$ dipole invert --albedo 0.5 --extinction-path 0.1 --unit cm --model better --format csv
model,channel,wanted_albedo,given,length,sigma_a,sigma_a_error,sigma_s,sigma_s_error,g,eta,albedo,albedo_model_error,status
better,1,0.5,extinction-path,1,0.024414830545433575,2.3245294578089215e-16,0.9755851694545663,6.931949552712285e-15,0,1.3,0.5000000000000001,0.04971605475924243,ok

$ dipole invert --albedo 0.5 --extinction-path 1 --unit inch
! dipole invert: --unit: mm, cm, m, or a number of millimetres
! `dipole invert --help` says more.
? 2

$ dipole invert --albedo 0.5 --diffuse-mean-free-path 1 --model better --format json
{
  "software": "dipoled 0.1.0",
  "model": "better",
  "moments": "exact",
  "given": "diffuse-mean-free-path",
  "formula": "1 / (sigma_t' sqrt(3 a / (1 + a))), a = sigma_a / sigma_t': Grosjean's",
  "albedo_least": 7.640417442483896e-62,
  "albedo_most": 1,
  "units": {"length": "mm", "sigma_a": "1/mm", "sigma_a_error": "1/mm", "sigma_s": "1/mm", "sigma_s_error": "1/mm"},
  "rows": [
    {"model": "better", "channel": 1, "wanted_albedo": 0.5, "given": "diffuse-mean-free-path", "length": 1, "sigma_a": 0.09130701779526736, "sigma_a_error": 6.487753821834542e-16, "sigma_s": 3.648510779643632, "sigma_s_error": 2.5924228308182022e-14, "g": 0, "eta": 1.3, "albedo": 0.5, "albedo_model_error": 0.04971605475924264, "status": "ok"}
  ]
}

$ dipole invert --albedo 0.05,0.5 --mean-free-path 1 --model single
model single, moments exact, given mean-free-path, = 1 / sigma_t', albedos from 7.57202e-32, to 0.0757202

channel  albedo  mean-free-path      sigma_a       +-      sigma_s       +-     sigma_s'  g  eta  its albedo  model error        status
         wanted              mm         1/mm     1/mm         1/mm     1/mm         1/mm
-------  ------  --------------  -----------  -------  -----------  -------  -----------  -  ---  ----------  -----------  ------------
1          0.05               1  0.339674161  1.3e-13  0.660325839  1.3e-13  0.660325839  0  1.3        0.05         0.54            ok
2           0.5               1            -        -            -        -            -  0  1.3           -            -  out of reach
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.982987 (eta 1.3)
! dipole invert: 1 of 2: there is no such medium: with this model, g and eta albedos above 0 go from 7.57e-32 to 0.075720193004692377, and without absorption there is no diffuse path
? 3

$ dipole invert --albedo 0.05,0.5 --mean-free-path 1 --model single --format csv
model,channel,wanted_albedo,given,length,sigma_a,sigma_a_error,sigma_s,sigma_s_error,g,eta,albedo,albedo_model_error,status
single,1,0.05,mean-free-path,1,0.3396741606707017,1.3455903058456897e-13,0.6603258393292983,1.3455903058456897e-13,0,1.3,0.049999999999999954,0.540041011913287,ok
single,2,0.5,mean-free-path,1,,,,,0,1.3,,,out of reach
! dipole invert: 1 of 2: there is no such medium: with this model, g and eta albedos above 0 go from 7.57e-32 to 0.075720193004692377, and without absorption there is no diffuse path
? 3

$ dipole invert --albedo 1 --diffuse-mean-free-path 1 --model better --format csv
model,channel,wanted_albedo,given,length,sigma_a,sigma_a_error,sigma_s,sigma_s_error,g,eta,albedo,albedo_model_error,status
better,1,1,diffuse-mean-free-path,1,,,,,0,1.3,,,no such length
! dipole invert: 1 of 1: there is no such medium: with this model, g and eta albedos above 0 go from 7.64e-62 to 1, and without absorption there is no diffuse path
? 3

$ dipole invert --albedo 1 --mean-free-path 1 --model better --format csv
model,channel,wanted_albedo,given,length,sigma_a,sigma_a_error,sigma_s,sigma_s_error,g,eta,albedo,albedo_model_error,status
better,1,1,mean-free-path,1,0,3.155443620884059e-31,1,7.105427357601002e-15,0,1.3,1,9.210000000000002e-6,ok

$ dipole invert --albedo 0.4,0.2 --mean-free-path 1 --model better --format csv | dipole points --r 0.5,2
model,channel,wanted_albedo,given,length,sigma_a,sigma_a_error,sigma_s,sigma_s_error,g,eta,albedo,albedo_model_error,status,r,R,cdf
better,1,0.4,mean-free-path,1,0.04254523875590417,3.400058012914542e-16,0.9574547612440959,6.8031252542091344e-15,0,1.3,0.4,0.08062980303955164,ok,0.5,0.034066219607273844,0.07589683682929961
better,1,0.4,mean-free-path,1,0.04254523875590417,3.400058012914542e-16,0.9574547612440959,6.8031252542091344e-15,0,1.3,0.4,0.08062980303955164,ok,2,0.00715953759805385,0.502126804616571
better,2,0.2,mean-free-path,1,0.12862311017013614,9.43689570931383e-16,0.8713768898298638,6.191505191778389e-15,0,1.3,0.1999999999999999,0.19863224922299103,ok,0.5,0.02330424401517404,0.10536196096925443
better,2,0.2,mean-free-path,1,0.12862311017013614,9.43689570931383e-16,0.8713768898298638,6.191505191778389e-15,0,1.3,0.1999999999999999,0.19863224922299103,ok,2,0.0037990923562216837,0.6282713999554665

$ dipole invert --albedo 0.735357 --srgb --extinction-path 1 --g 0.9 --eta 1.5 --light diffuse --format csv
model,channel,wanted_albedo,given,length,sigma_a,sigma_a_error,sigma_s,sigma_s_error,g,eta,albedo,albedo_model_error,status
transport,1,0.5000000257314877,extinction-path,1,0.0018993733816842497,8.969714879701607e-11,0.9981006266183158,8.969724962781811e-11,0.9,1.5,0.5000000257314856,0,ok

$ dipole invert --albedo 0.5 --extinction-path 1 --model better --specular --format csv
model,channel,wanted_albedo,given,length,sigma_a,sigma_a_error,sigma_s,sigma_s_error,g,eta,albedo,albedo_model_error,status
better,1,0.5,extinction-path,1,0.02565594071782214,2.914335439641036e-16,0.9743440592821778,6.923130934539599e-15,0,1.3,0.49999999999999967,0.05194148644209929,ok

$ dipole invert
! dipole invert: give --albedo, and --mean-free-path; or FILE, which has them
! `dipole invert --help` says more.
? 2

$ dipole invert --albedo 0.5
! dipole invert: give exactly one of --mean-free-path, --diffuse-mean-free-path, --classical-diffuse-path and --extinction-path
! `dipole invert --help` says more.
? 2

$ dipole invert --albedo 0.5 --mean-free-path 1 --diffuse-mean-free-path 1
! dipole invert: give exactly one of --mean-free-path, --diffuse-mean-free-path, --classical-diffuse-path and --extinction-path
! `dipole invert --help` says more.
? 2

$ dipole invert --albedo 0.1,0.2 --mean-free-path 1,2,3
! dipole invert: --mean-free-path has 3 values and --albedo has 2: give one value or as many
! `dipole invert --help` says more.
? 2

$ dipole invert --albedo half --mean-free-path 1
! dipole invert: --albedo: 'half' is no decimal number
! `dipole invert --help` says more.
? 2

$ dipole invert --albedo 0.5 --mean-free-path 1 --sigma-a 1
! dipole invert: --sigma-a: no such option
! `dipole invert --help` says more.
? 2

$ dipole invert --albedo 0.1,1.5 --mean-free-path 1
! dipole invert: channel 2: bad-value: albedo: allowed: 0 to 1 (--albedo)
? 1

$ dipole invert --albedo 0.1 --mean-free-path 0
! dipole invert: bad-value: length: allowed: 1e-14 to 1e14 mm (--mean-free-path)
? 1

$ dipole invert --albedo 0.1 --classical-diffuse-path -1
! dipole invert: bad-value: length: allowed: 1e-14 to 1e14 mm (--classical-diffuse-path)
? 1

$ dipole invert --albedo 0.1 --mean-free-path 1 --g 1
! dipole invert: bad-value: g: allowed: between -1 and 1, exclusive (--g)
? 1

$ dipole invert --albedo 0.1 --mean-free-path 1 --model skin-red
! dipole invert: bad-value: model: allowed: a model whose albedo depends on the medium (--model)
? 1

$ dipole invert --albedo 0.1 --mean-free-path 1 --model multipole
! dipole invert: bad-value: thickness: allowed: above 0 mm: this model is of a slab
? 1

$ printf 'name,albedo,mean_free_path\na,0.25,1.5\nb,0.75,1.5\n' > colours.csv; dipole invert colours.csv --model better --format csv
model,channel,wanted_albedo,given,length,sigma_a,sigma_a_error,sigma_s,sigma_s_error,g,eta,albedo,albedo_model_error,status
better,1,0.25,mean-free-path,1.5,0.06418382138301043,4.85722573273506e-16,0.6024828452836561,4.280898091363782e-15,0,1.3,0.2500000000000001,0.15835457406861445,ok
better,2,0.75,mean-free-path,1.5,0.002808601778911392,4.336808689942018e-17,0.6638580648877552,4.716995255817517e-15,0,1.3,0.75,0.010105733497662793,ok

$ printf 'albedo\n0.25\n\n0.75\n' | dipole invert - --mean-free-path 1,2 --g 0.8 --eta 1.4 --model better --format csv
model,channel,wanted_albedo,given,length,sigma_a,sigma_a_error,sigma_s,sigma_s_error,g,eta,albedo,albedo_model_error,status
better,1,0.25,mean-free-path,1,0.08006372314328833,5.688869687737134e-16,4.599681384283559,3.268270194413645e-14,0.8,1.4,0.25000000000000006,0.11150159047869569,ok
better,2,0.75,mean-free-path,2,0.001605803268234967,2.688821387764051e-17,2.4919709836588253,1.7706518801637296e-14,0.8,1.4,0.7499999999999999,0.009670642264622656,ok

$ dipole invert colours.csv --mean-free-path 1
! dipole invert: colours.csv: the header has the column mean_free_path: leave that option out
? 1

$ printf 'albedo,g\n0.25,0.8\n' | dipole invert - --mean-free-path 1
! dipole invert: standard input: the header has the column g: all rows have that of --g; rename it
? 1

$ printf 'albedo,mean_free_path\n0.25,\n' | dipole invert -
! dipole invert: standard input: line 2: mean_free_path: there is no number
? 1

$ printf 'mean_free_path\n1\n' | dipole invert -
! dipole invert: standard input: the column albedo is missing; the header has mean_free_path; it needs albedo, and a length such as mean_free_path unless an option gives it
? 1

## Each command says which name of a choice it does not know, and sends nothing.
$ printf 'r,R,error\n1,1,.1\n' > r.csv; of='--sigma-a 0.1 --sigma-s 1'; printf '%s\n' 'invert --albedo .5 --extinction-path 1 --light' 'invert --albedo .5 --extinction-path 1 --moments' 'sample OF --moments' 'sample OF --wanted' 'table OF --moments' 'mc OF --phase' 'gather r.csv r.csv OF --moments' 'gather r.csv r.csv OF --evaluator' 'fit r.csv --moments' 'plot OF --moments' 'points --evaluator' 'points --wanted' 'texture a.png b.png --extinction-path 1 --light' 'texture a.png b.png --extinction-path 1 --moments' | sed "s/OF/$of/" | while read -r one; do dipole $one none > out 2>&1 < r.csv; echo "$? $(head -n 1 out | cut -d';' -f1)"; done
2 dipole invert: --light: 'none' is unknown
2 dipole invert: --moments: 'none' is unknown
2 dipole sample: --moments: 'none' is unknown
2 dipole sample: --wanted: 'none' is unknown
2 dipole table: --moments: 'none' is unknown
2 dipole mc: --phase: 'none' is unknown
2 dipole gather: --moments: 'none' is unknown
2 dipole gather: --evaluator: 'none' is unknown
2 dipole fit: --moments: 'none' is unknown
2 dipole plot: --moments: 'none' is unknown
2 dipole points: --evaluator: 'none' is unknown
2 dipole points: --wanted: 'none' is unknown
2 dipole texture: --light: 'none' is unknown
2 dipole texture: --moments: 'none' is unknown
