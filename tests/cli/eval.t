## dipole eval: the same numbers as a table, as CSV and as JSON.
$ dipole eval --medium skin1 --model classical,better --count 3
skin1, moments exact, R in 1/mm^2 per unit of power that entered

     classical   classical   classical      better      better      better
 r       R red     R green      R blue       R red     R green      R blue
mm      1/mm^2      1/mm^2      1/mm^2      1/mm^2      1/mm^2      1/mm^2
--  ----------  ----------  ----------  ----------  ----------  ----------
 0  4.4433e-02  6.2826e-02  8.9258e-02  2.6396e-02  3.0135e-02  3.3296e-02
 5  8.0218e-04  1.0260e-04  2.9839e-06  9.6938e-04  1.3361e-04  5.8228e-06
10  7.4269e-05  1.0322e-06  7.6634e-10  8.4214e-05  1.6231e-06  3.6897e-09

                                                                       R            R           albedo       albedo
model      channel  sigma_a  sigma_s  g  eta     albedo  numerical error  model error  numerical error  model error  evaluator  notes
                       1/mm     1/mm                  1
---------  -------  -------  -------  -  ---  ---------  ---------------  -----------  ---------------  -----------  ---------  -----
classical  red        0.032     0.74  0  1.3   0.436049          7.2e-15      6.4e-02          2.4e-15      7.8e-03        f64
classical  green       0.17     0.88  0  1.3   0.227366          1.6e-14      3.5e-01          3.0e-15      6.6e-02        f64
classical  blue        0.48     1.01  0  1.3    0.13101          3.0e-14      8.2e-01          3.5e-15      1.3e-01        f64
better     red        0.032     0.74  0  1.3   0.404808          7.1e-15      1.6e-01          2.4e-15      7.9e-02        f64
better     green       0.17     0.88  0  1.3   0.162793          1.5e-14      1.5e-01          2.9e-15      2.4e-01        f64
better     blue        0.48     1.01  0  1.3  0.0701464          2.6e-14      1.3e-01          3.3e-15      3.9e-01        f64
numerical error: at most, against the model's formula, at r = 0 to 10 mm
model error: the largest, of the model against radiative transport, at r > 0: transport diverges at r = 0
errors are relative, but of ln R, its derivatives, paths and modulated light absolute, as the
cdf's model error is, and of R_f over the albedo
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.982987 (eta 1.3)

$ dipole eval --medium skin1 --channel red --model classical,better --count 3 --format csv
model,channel,sigma_a,sigma_s,g,eta,r,R,albedo,numerical_error,model_error,numerical_error_R,model_error_R,numerical_error_albedo,model_error_albedo,evaluator,notes
classical,red,0.032,0.74,0,1.3,0,0.04443318995075527,0.4360488981000882,2.402764671015483e-15,0.06360699167201807,2.402764671015483e-15,0.06360699167201807,2.402764671015483e-15,0.007759948092650409,f64,
classical,red,0.032,0.74,0,1.3,5,8.021768997285513e-4,0.4360488981000882,4.820698901050279e-15,0.06360699167201807,4.820698901050279e-15,0.06360699167201807,2.402764671015483e-15,0.007759948092650409,f64,
classical,red,0.032,0.74,0,1.3,10,7.426864799726663e-5,0.4360488981000882,7.238633131085076e-15,0.06360699167201807,7.238633131085076e-15,0.06360699167201807,2.402764671015483e-15,0.007759948092650409,f64,
better,red,0.032,0.74,0,1.3,0,0.026396169457422243,0.4048076115742095,2.3901722738496005e-15,0.15775939884318416,2.3901722738496005e-15,0.15775939884318416,2.3901722738496005e-15,0.07885072820519266,f64,
better,red,0.032,0.74,0,1.3,5,9.693772895059612e-4,0.4048076115742095,4.7594998508240916e-15,0.15775939884318416,4.7594998508240916e-15,0.15775939884318416,2.3901722738496005e-15,0.07885072820519266,f64,
better,red,0.032,0.74,0,1.3,10,8.421414694343739e-5,0.4048076115742095,7.128827427798584e-15,0.15775939884318416,7.128827427798584e-15,0.15775939884318416,2.3901722738496005e-15,0.07885072820519266,f64,

$ dipole eval --medium skin1 --channel red --r 0,1,inf --wanted R,albedo,cdf --model better,transport --format json
{
  "software": "dipoled 0.1.0",
  "medium": "skin1",
  "moments": "exact",
  "R": "1/mm^2 per unit of power that entered",
  "units": {"sigma_a": "1/mm", "sigma_s": "1/mm", "r": "mm", "R": "1/mm^2", "albedo": "1", "cdf": "1"},
  "rows": [
    {"model": "better", "channel": "red", "sigma_a": 0.032, "sigma_s": 0.74, "g": 0, "eta": 1.3, "r": 0, "R": 0.026396169457422243, "albedo": 0.4048076115742095, "cdf": 0, "numerical_error": 2.3901722738496005e-15, "model_error": 0.17190248081160078, "numerical_error_R": 2.3901722738496005e-15, "model_error_R": 0.013989674510023978, "numerical_error_albedo": 2.3901722738496005e-15, "model_error_albedo": 0.07885072820519266, "numerical_error_cdf": 2.3901722738496005e-15, "model_error_cdf": 0.17190248081160078, "evaluator": "f64", "notes": ""},
    {"model": "better", "channel": "red", "sigma_a": 0.032, "sigma_s": 0.74, "g": 0, "eta": 1.3, "r": 1, "R": 0.015481882273229152, "albedo": 0.4048076115742095, "cdf": 0.15524509398211575, "numerical_error": 2.8640377892444987e-15, "model_error": 0.17190248081160078, "numerical_error_R": 2.8640377892444987e-15, "model_error_R": 0.013989674510023978, "numerical_error_albedo": 2.3901722738496005e-15, "model_error_albedo": 0.07885072820519266, "numerical_error_cdf": 2.8640377892444987e-15, "model_error_cdf": 0.17190248081160078, "evaluator": "f64", "notes": ""},
    {"model": "better", "channel": "red", "sigma_a": 0.032, "sigma_s": 0.74, "g": 0, "eta": 1.3, "r": "inf", "R": 0, "albedo": 0.4048076115742095, "cdf": 1, "numerical_error": 2.3901722738496005e-15, "model_error": 0.17190248081160078, "numerical_error_R": 2.3901722738496005e-15, "model_error_R": 0.013989674510023978, "numerical_error_albedo": 2.3901722738496005e-15, "model_error_albedo": 0.07885072820519266, "numerical_error_cdf": 2.3901722738496005e-15, "model_error_cdf": 0.17190248081160078, "evaluator": "f64", "notes": ""},
    {"model": "transport", "channel": "red", "sigma_a": 0.032, "sigma_s": 0.74, "g": 0, "eta": 1.3, "r": 0, "R": "inf", "albedo": 0.43945764501319085, "cdf": 0, "numerical_error": 8.30018799703575e-5, "model_error": 0, "numerical_error_R": 8.30018799703575e-5, "model_error_R": 0, "numerical_error_albedo": 8.30018799703575e-5, "model_error_albedo": 0, "numerical_error_cdf": 8.30018799703575e-5, "model_error_cdf": 0, "evaluator": "lut", "notes": ""},
    {"model": "transport", "channel": "red", "sigma_a": 0.032, "sigma_s": 0.74, "g": 0, "eta": 1.3, "r": 1, "R": 0.01570149, "albedo": 0.43945764501319085, "cdf": 0.32714382, "numerical_error": 8.30018799703575e-5, "model_error": 0, "numerical_error_R": 8.30018799703575e-5, "model_error_R": 0, "numerical_error_albedo": 8.30018799703575e-5, "model_error_albedo": 0, "numerical_error_cdf": 8.30018799703575e-5, "model_error_cdf": 0, "evaluator": "lut", "notes": ""},
    {"model": "transport", "channel": "red", "sigma_a": 0.032, "sigma_s": 0.74, "g": 0, "eta": 1.3, "r": "inf", "R": 0, "albedo": 0.43945764501319085, "cdf": 1, "numerical_error": 8.30018799703575e-5, "model_error": 0, "numerical_error_R": 8.30018799703575e-5, "model_error_R": 0, "numerical_error_albedo": 8.30018799703575e-5, "model_error_albedo": 0, "numerical_error_cdf": 8.30018799703575e-5, "model_error_cdf": 0, "evaluator": "lut", "notes": ""}
  ]
}

$ dipole eval --sigma-a 0.01,0.1 --sigma-s 10 --g 0.9 --eta 1.4 --model better --wanted cdf --r 2
moments exact, R in 1/mm^2 per unit of power that entered

      better    better
 r     cdf 1     cdf 2
mm         1         1
--  --------  --------
 2  0.370764  0.620164

model   channel  sigma_a  sigma_s    g  eta  numerical error  model error  evaluator       notes
                    1/mm     1/mm
------  -------  -------  -------  ---  ---  ---------------  -----------  ---------  ----------
better  1           0.01       10  0.9  1.4          2.7e-15      2.3e-02        f64  similarity
better  2            0.1       10  0.9  1.4          4.6e-15      1.9e-02        f64  similarity
numerical error: at most, against the model's formula, at r = 2 mm
model error: the largest, of the model against radiative transport
errors are relative, but of ln R, its derivatives, paths and modulated light absolute, as the
cdf's model error is, and of R_f over the albedo
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.972222 (eta 1.4)
note: similarity: g is not 0: the model uses isotropic scattering with sigma_s (1 - g)

$ dipole eval --sigma-a 0.01,0.1 --sigma-s 10 --g 0.9 --eta 1.4 --model better --wanted albedo --format csv
model,channel,sigma_a,sigma_s,g,eta,albedo,numerical_error,model_error,evaluator,notes
better,1,0.01,10,0.9,1.4,0.605952712135344,2.080999524065612e-15,0.024579259979243692,f64,similarity
better,2,0.1,10,0.9,1.4,0.22887417356461276,2.6645352591003757e-15,0.11830496817362056,f64,similarity

$ dipole eval --sigma-a 0.1 --sigma-s 1 --model better --format csv | awk -F, '{print $7}' | tr '\n' ' '
r 0 0.5 1 1.5 2 2.5 3 3.5 4 4.5 5 5.5 6 6.5 7 7.5 8 8.5 9 9.5 10 

$ dipole eval --medium marble --eta 1.2,1.3,1.5 --r 1 --format csv --model better
model,channel,sigma_a,sigma_s,g,eta,r,R,albedo,numerical_error,model_error,numerical_error_R,model_error_R,numerical_error_albedo,model_error_albedo,evaluator,notes
better,red,0.0021,2.19,0,1.2,1,0.05007482829194086,0.8879691096734903,2.0801925875891195e-15,0.24079851151929055,2.0801925875891195e-15,0.24079851151929055,1.8715404953599225e-15,0.0023343595595734404,f64,
better,green,0.0041,2.62,0,1.3,1,0.048447134610163936,0.8392773086273129,2.2167633548627504e-15,0.18545813843756997,2.2167633548627504e-15,0.18545813843756997,1.897878462827446e-15,0.004089671466523475,f64,
better,blue,0.0071,3,0,1.5,1,0.04274182810107147,0.7542858791284851,2.374719055719728e-15,0.10979533811716059,2.374719055719728e-15,0.10979533811716059,1.9256823407152856e-15,0.009275028690289015,f64,

$ dipole eval --medium skin1 --channel blue --g 0.8 --r 1 --format csv --model better
model,channel,sigma_a,sigma_s,g,eta,r,R,albedo,numerical_error,model_error,numerical_error_R,model_error_R,numerical_error_albedo,model_error_albedo,evaluator,notes
better,blue,0.48,5.050000000000001,0.8,1.3,1,0.00576535423426011,0.0701464120117238,5.557975153249722e-15,0.23939517706945185,5.557975153249722e-15,0.014552341512742211,3.2950790537976285e-15,0.23939517706945185,f64,similarity

$ dipole eval --medium marble,skin1 --channel red,blue --eta 1.1,1.2,1.3,1.4 --r 1 --format csv --model better
model,channel,sigma_a,sigma_s,g,eta,r,R,albedo,numerical_error,model_error,numerical_error_R,model_error_R,numerical_error_albedo,model_error_albedo,evaluator,notes
better,marble red,0.0021,2.19,0,1.1,1,0.053527813074979426,0.9020892190941748,2.0801925875891195e-15,0.28316312222320184,2.0801925875891195e-15,0.28316312222320184,1.8715404953599225e-15,0.0021581039308645167,f64,
better,marble blue,0.0071,3,0,1.2,1,0.0512111906873481,0.8293255231173589,2.374719055719728e-15,0.20246642018463545,2.374719055719728e-15,0.20246642018463545,1.9256823407152856e-15,0.005300591587905105,f64,
better,skin1 red,0.032,0.74,0,1.3,1,0.015481882273229152,0.4048076115742095,2.8640377892444987e-15,0.07885072820519266,2.8640377892444987e-15,0.01398967451002485,2.3901722738496005e-15,0.07885072820519266,f64,
better,skin1 blue,0.48,1.01,0,1.4,1,0.004954157187455209,0.06038796649866023,5.557975153249722e-15,0.38936304598819654,5.557975153249722e-15,0.2992972712541488,3.2950790537976285e-15,0.38936304598819654,f64,

$ dipole eval --medium marble,skin1 --channel red,blue --eta 1,2,3
! dipole eval: --eta has 3 values and --medium has 4: give one value or as many
! `dipole eval --help` says more.
? 2

## Grids: the shortest numbers.
$ dipole eval --sigma-a 0.1 --sigma-s 1 --model better --wanted R --from 0.01 --to 100 --count 5 --log --format csv
model,channel,sigma_a,sigma_s,g,eta,r,R,numerical_error,model_error,evaluator,notes
better,1,0.1,1,0,1.3,0.01,0.04350332405227486,2.674305221717077e-15,0.9920803284170651,f64,
better,1,0.1,1,0,1.3,0.1,0.04286625662620181,2.7622348852673894e-15,0.9920803284170651,f64,
better,1,0.1,1,0,1.3,1,0.0164987142816284,3.641531520770513e-15,0.9920803284170651,f64,
better,1,0.1,1,0,1.3,10,6.039401959519168e-6,1.2434497875801753e-14,0.9920803284170651,f64,
better,1,0.1,1,0,1.3,100,2.285061708563905e-29,1.0036416142611416e-13,0.9920803284170651,f64,

$ dipole eval --sigma-a 0.1 --sigma-s 1 --model better --wanted R --from 0.1 --to 0.1 --count 1 --evaluator f32 --format csv
model,channel,sigma_a,sigma_s,g,eta,r,R,numerical_error,model_error,evaluator,notes
better,1,0.1,1,0,1.3,0.1,0.042866264,1.4829635620117187e-6,0.8936313392904222,f32,

$ dipole eval --sigma-a 0.1 --sigma-s 1 --model better --wanted R --from 0.023 --to 1.863 --count 21 --format csv | grep -c ',0.943,'
1

## Models are asked for once each; transport is by table, whether it is named or not.
$ dipole eval --sigma-a 0.1 --sigma-s 1 --r 1 --model classical,better,classical --format csv
model,channel,sigma_a,sigma_s,g,eta,r,R,albedo,numerical_error,model_error,numerical_error_R,model_error_R,numerical_error_albedo,model_error_albedo,evaluator,notes
classical,1,0.1,1,0,1.3,1,0.023011708280071198,0.3137401295412308,3.724468258285356e-15,0.5924547482333712,3.724468258285356e-15,0.5924547482333712,2.704028943631253e-15,0.023267547277642527,f64,
better,1,0.1,1,0,1.3,1,0.01649871428162842,0.26022500449976643,3.641531520770513e-15,0.1512791549091128,3.641531520770513e-15,0.14174295874759027,2.6645352591003757e-15,0.1512791549091128,f64,

$ dipole eval --sigma-a 0.1 --sigma-s 1 --r 1 --format csv
model,channel,sigma_a,sigma_s,g,eta,r,R,albedo,numerical_error,model_error,numerical_error_R,model_error_R,numerical_error_albedo,model_error_albedo,evaluator,notes
transport,1,0.1,1,0,1.3,1,0.014450509,0.30660714050957727,8.405402399277573e-5,0,8.405402399277573e-5,0,8.405402399277573e-5,0,lut,

$ dipole eval --sigma-a 0.1 --sigma-s 1 --r 1 --model transport --tolerance 1e-7 --format csv
model,channel,sigma_a,sigma_s,g,eta,r,R,albedo,numerical_error,model_error,numerical_error_R,model_error_R,numerical_error_albedo,model_error_albedo,evaluator,notes
transport,1,0.1,1,0,1.3,1,0.014450509299045051,0.30660714050957727,3.2100000000000006e-6,0,3.2100000000000006e-6,0,3.2100000000000006e-6,0,f64,

## Spatial frequencies are no radii.
$ dipole eval --sigma-a 0.01 --sigma-s 10 --g 0.9 --eta 1.4 --model better --f 0.1,1
moments exact, R_f, the reflectance of striped light

           better
   f        R_f 1
1/mm            1
----  -----------
 0.1     0.213234
   1  0.000351603

                                                                albedo       albedo              R_f          R_f
model   channel  sigma_a  sigma_s    g  eta    albedo  numerical error  model error  numerical error  model error  evaluator       notes
                    1/mm     1/mm                   1
------  -------  -------  -------  ---  ---  --------  ---------------  -----------  ---------------  -----------  ---------  ----------
better  1           0.01       10  0.9  1.4  0.605953          2.1e-15      2.5e-02          1.0e-09      3.5e-02        f64  similarity
numerical error: at most, against the model's formula, at f = 0.1 to 1 1/mm
model error: the largest, of the model against radiative transport
errors are relative, but of ln R, its derivatives, paths and modulated light absolute, as the
cdf's model error is, and of R_f over the albedo
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.972222 (eta 1.4)
note: similarity: g is not 0: the model uses isotropic scattering with sigma_s (1 - g)

$ dipole eval --sigma-a 0.01 --sigma-s 10 --g 0.9 --eta 1.4 --model better --wanted R_f,albedo --f 0.1,1 --format csv
model,channel,sigma_a,sigma_s,g,eta,f,albedo,R_f,numerical_error,model_error,numerical_error_albedo,model_error_albedo,numerical_error_R_f,model_error_R_f,evaluator,notes
better,1,0.01,10,0.9,1.4,0.1,0.605952712135344,0.21323395498981187,1.0000021117684354e-9,0.034505775471083716,2.080999524065612e-15,0.02457925997924352,1.0000021117684354e-9,0.034505775471083716,f64,similarity
better,1,0.01,10,0.9,1.4,1,0.605952712135344,3.516034949555704e-4,1.0000023886886356e-9,0.034505775471083716,2.080999524065612e-15,0.02457925997924352,1.0000023886886356e-9,0.034505775471083716,f64,similarity

$ dipole eval --sigma-a 0.01 --sigma-s 10 --g 0.9 --eta 1.4 --model better --f 0.1 --format json
{
  "software": "dipoled 0.1.0",
  "moments": "exact",
  "R_f": "R_f, the reflectance of striped light",
  "units": {"sigma_a": "1/mm", "sigma_s": "1/mm", "f": "1/mm", "albedo": "1", "R_f": "1"},
  "rows": [
    {"model": "better", "channel": "1", "sigma_a": 0.01, "sigma_s": 10, "g": 0.9, "eta": 1.4, "f": 0.1, "albedo": 0.605952712135344, "R_f": 0.21323395498981187, "numerical_error": 1.0000021117684354e-9, "model_error": 0.034505775471083716, "numerical_error_albedo": 2.080999524065612e-15, "model_error_albedo": 0.02457925997924352, "numerical_error_R_f": 1.0000021117684354e-9, "model_error_R_f": 0.034505775471083716, "evaluator": "f64", "notes": "similarity"}
  ]
}

$ dipole eval --sigma-a 0.01 --sigma-s 10 --f 1 --r 1 || dipole eval --sigma-a 0.01 --sigma-s 10 --f 1,-1 || dipole eval --sigma-a 0.01 --sigma-s 10 --model transport,better --wanted balance
! dipole eval: what ends with _f is at the spatial frequencies of --f, all else at the radii of --r: request one of both
! `dipole eval --help` says more.
! dipole eval: --f: -1 is no spatial frequency: give 0 or more, in 1/mm
! `dipole eval --help` says more.
! dipole eval: model better: bad-value: wanted: allowed: no balance: this model has only R; transport has it (--wanted)
? 1

$ dipole eval --sigma-a 0.01 --sigma-s 10 --f 1 --wanted R
! dipole eval: what ends with _f is at the spatial frequencies of --f, all else at the radii of --r: request one of both
! `dipole eval --help` says more.
? 2

$ dipole eval --sigma-a 0.01 --sigma-s 10 --f 1 --to 2
! dipole eval: --f gives the frequencies one by one: leave --from, --to, --count and --log out
! `dipole eval --help` says more.
? 2

## The slope, the logarithm and the density have units of their own.
$ dipole eval --sigma-a 0.1 --sigma-s 1 --model better --r 0.5,2 --wanted dR_dr,ln_R,pdf
moments exact, R in 1/mm^2 per unit of power that entered

          better      better      better
  r      dR_dr 1      ln_R 1       pdf 1
 mm       1/mm^3  ln(1/mm^2)        1/mm
---  -----------  ----------  ----------
0.5  -3.5744e-02    -3.46021  3.7936e-01
  2  -5.3739e-03     -5.3319  2.3348e-01

                                                     dR_dr        dR_dr             ln_R         ln_R              pdf          pdf
model   channel  sigma_a  sigma_s  g  eta  numerical error  model error  numerical error  model error  numerical error  model error  evaluator  notes
                    1/mm     1/mm
------  -------  -------  -------  -  ---  ---------------  -----------  ---------------  -----------  ---------------  -----------  ---------  -----
better  1            0.1        1  0  1.3          5.3e-15      7.3e-01          4.6e-15      3.2e-01          4.6e-15      4.5e-01        f64
numerical error: at most, against the model's formula, at r = 0.5 to 2 mm
model error: the largest, of the model against radiative transport
errors are relative, but of ln R, its derivatives, paths and modulated light absolute, as the
cdf's model error is, and of R_f over the albedo
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.982987 (eta 1.3)

$ dipole eval --sigma-a 0.1 --sigma-s 1 --model better --r 0.5,2 --wanted dR_dr,ln_R,pdf --format json
{
  "software": "dipoled 0.1.0",
  "moments": "exact",
  "R": "1/mm^2 per unit of power that entered",
  "units": {"sigma_a": "1/mm", "sigma_s": "1/mm", "r": "mm", "dR_dr": "1/mm^3", "ln_R": "ln(1/mm^2)", "pdf": "1/mm"},
  "rows": [
    {"model": "better", "channel": "1", "sigma_a": 0.1, "sigma_s": 1, "g": 0, "eta": 1.3, "r": 0.5, "dR_dr": -0.03574352502251292, "ln_R": -3.460211240510665, "pdf": 0.37935883244269936, "numerical_error": 3.819167204710538e-15, "model_error": 0.7265671422593621, "numerical_error_dR_dr": 3.819167204710538e-15, "model_error_dR_dr": 0.7265671422593621, "numerical_error_ln_R": 3.1530333899354444e-15, "model_error_ln_R": 0.31666636373214124, "numerical_error_pdf": 3.1530333899354444e-15, "model_error_pdf": 0.4450895521160206, "evaluator": "f64", "notes": ""},
    {"model": "better", "channel": "1", "sigma_a": 0.1, "sigma_s": 1, "g": 0, "eta": 1.3, "r": 2, "dR_dr": -0.00537387880653355, "ln_R": -5.3318958015403215, "pdf": 0.23347904842251382, "numerical_error": 5.284661597215745e-15, "model_error": 0.7265671422593621, "numerical_error_dR_dr": 5.284661597215745e-15, "model_error_dR_dr": 0.7265671422593621, "numerical_error_ln_R": 4.618527782440651e-15, "model_error_ln_R": 0.31666636373214124, "numerical_error_pdf": 4.618527782440651e-15, "model_error_pdf": 0.4450895521160206, "evaluator": "f64", "notes": ""}
  ]
}

$ dipole eval --sigma-a 0.1 --sigma-s 1 --model better --r 0.5,2 --wanted dR_dr,ln_R,pdf --evaluator f32 --format csv
model,channel,sigma_a,sigma_s,g,eta,r,dR_dr,ln_R,pdf,numerical_error,model_error,numerical_error_dR_dr,model_error_dR_dr,numerical_error_ln_R,model_error_ln_R,numerical_error_pdf,model_error_pdf,evaluator,notes
better,1,0.1,1,0,1.3,0.5,-0.03574352,-3.460211,0.37935886,2.0503997802734374e-6,0.7265671832834677,2.0503997802734374e-6,0.7265671832834677,1.6927719116210937e-6,0.31666616181030577,1.6927719116210937e-6,0.4450894868699966,f32,
better,1,0.1,1,0,1.3,2,-0.0053738784,-5.331896,0.23347904,2.837181091308594e-6,0.7265671832834677,2.837181091308594e-6,0.7265671832834677,2.47955322265625e-6,0.31666616181030577,2.47955322265625e-6,0.4450894868699966,f32,

$ dipole eval --sigma-a 0.1 --sigma-s 1 --model better --r 0.5 --wanted R,model_errors --errors --format csv | head -1
model,channel,sigma_a,sigma_s,g,eta,r,R,model_errors,numerical_error,model_error,evaluator,notes

## Tolerances in place of a model.
$ dipole eval --medium skin1 --tolerance 0.01 --r 1,2
skin1, moments exact, tolerance 0.01, R in 1/mm^2 per unit of power that entered

     transport   transport   transport
 r       R red     R green      R blue
mm      1/mm^2      1/mm^2      1/mm^2
--  ----------  ----------  ----------
 1  1.5701e-02  1.0142e-02  4.5069e-03
 2  5.5199e-03  2.4111e-03  5.9256e-04

                                                                      R            R           albedo       albedo
model      channel  sigma_a  sigma_s  g  eta    albedo  numerical error  model error  numerical error  model error  evaluator  notes
                       1/mm     1/mm                 1
---------  -------  -------  -------  -  ---  --------  ---------------  -----------  ---------------  -----------  ---------  -----
transport  red        0.032     0.74  0  1.3  0.439458          3.3e-06      0.0e+00          3.3e-06      0.0e+00        f32
transport  green       0.17     0.88  0  1.3  0.213259          3.3e-06      0.0e+00          3.3e-06      0.0e+00        f32
transport  blue        0.48     1.01  0  1.3  0.115435          3.3e-06      0.0e+00          3.3e-06      0.0e+00        f32
numerical error: at most, against the model's formula, at r = 1 to 2 mm
model error: the largest, of the model against radiative transport
errors are relative, but of ln R, its derivatives, paths and modulated light absolute, as the
cdf's model error is, and of R_f over the albedo
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.982987 (eta 1.3)
took transport (f32), the cheapest that keeps the tolerance

$ dipole eval --sigma-a 0.05 --sigma-s 9.5 --g 0.9 --eta 1.4 --tolerance 1e-5 --r 1,2 --format csv
! dipole eval: bad-value: tolerance: allowed: at least 0.000101 (best: transport, solved) (--tolerance)
? 1

$ dipole eval --sigma-a 0.05 --sigma-s 9.5 --g 0.9 --eta 1.4 --tolerance 1e-5 --evaluator f32 --r 1,2
! dipole eval: bad-value: tolerance: allowed: at least 0.000101 (best: transport, solved) (--tolerance)
? 1

## Parameters and notes.
$ dipole eval --sigma-a 0.032 --sigma-s 0.74 --model better --r 1 --wanted S --cos-in 0.8 --cos-out 0.25
moments exact, cos_in 0.8, cos_out 0.25, R in 1/mm^2 per unit of power that entered

         better
 r          S 1
mm  1/(mm^2 sr)
--  -----------
 1   4.0547e-03

model   channel  sigma_a  sigma_s  g  eta  numerical error  model error  evaluator  notes
                    1/mm     1/mm
------  -------  -------  -------  -  ---  ---------------  -----------  ---------  -----
better  1          0.032     0.74  0  1.3          4.6e-15      1.4e-02        f64
numerical error: at most, against the model's formula, at r = 1 mm
model error: the largest, of the model against radiative transport
errors are relative, but of ln R, its derivatives, paths and modulated light absolute, as the
cdf's model error is, and of R_f over the albedo
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.982987 (eta 1.3)

$ dipole eval --sigma-a 0.032 --sigma-s 0.74 --model better --r 1 --wanted S --cos-in 0.8 --format json
{
  "software": "dipoled 0.1.0",
  "moments": "exact",
  "cos_in": 0.8,
  "R": "1/mm^2 per unit of power that entered",
  "units": {"sigma_a": "1/mm", "sigma_s": "1/mm", "r": "mm", "S": "1/(mm^2 sr)"},
  "rows": [
    {"model": "better", "channel": "1", "sigma_a": 0.032, "sigma_s": 0.74, "g": 0, "eta": 1.3, "r": 1, "S": 0.005058993446080879, "numerical_error": 4.640394628644749e-15, "model_error": 0.013989674510023978, "evaluator": "f64", "notes": ""}
  ]
}

$ dipole eval --sigma-a 0.032 --sigma-s 0.74 --model gaussians --r 1 --fit-model classical --format csv
model,channel,sigma_a,sigma_s,g,eta,r,R,albedo,numerical_error,model_error,numerical_error_R,model_error_R,numerical_error_albedo,model_error_albedo,evaluator,notes
gaussians,1,0.032,0.74,0,1.3,1,0.022003446135484304,0.4351174018643613,0.0016572261195275356,0.4013648964112026,0.0016572261195275356,0.4013648964112026,0.001657226119526083,0.009879604529169599,f64,

$ dipole eval --sigma-a 0.032 --sigma-s 0.74 --model gaussians --r 1 --fit-model 1 --format csv
model,channel,sigma_a,sigma_s,g,eta,r,R,albedo,numerical_error,model_error,numerical_error_R,model_error_R,numerical_error_albedo,model_error_albedo,evaluator,notes
gaussians,1,0.032,0.74,0,1.3,1,0.022003446135484304,0.4351174018643613,0.0016572261195275356,0.4013648964112026,0.0016572261195275356,0.4013648964112026,0.001657226119526083,0.009879604529169599,f64,

$ dipole eval --sigma-a 0.032 --sigma-s 0.74 --model gaussians --r 1 --fit-model best
! dipole eval: --fit-model: 'best' is unknown; this daemon has classical, better, grosjean, boundary, exitance, grosjean-boundary, grosjean-exitance, boundary-exitance, extended, quantized, beam, single, classical+single, better+single, extended+single, quantized+single, beam+single, burley, burley-diffuse, burley-dmfp, skin-red, skin-green, skin-blue, gaussians, multipole, multipole-transmitted, better-multipole, better-multipole-transmitted, transport, transport-transmitted. Is it beam?
! `dipole eval --help` says more.
? 2

$ dipole eval --sigma-a 0.032 --sigma-s 0.74 --model better --r 1 --cos-in x
! dipole eval: --cos-in: 'x' is no decimal number
! `dipole eval --help` says more.
? 2

$ for one in '--sigma-a 0.032 --sigma-s 0.74 --model better --r 1 --cos-in 1.5' '--sigma-a 0.032 --sigma-s 0.74 --model better --r 1 --cos-out nan' '--sigma-a 0.032 --sigma-s 0.74 --model better --r 1 --thickness 3' '--sigma-a 0.032 --sigma-s 0.74 --model better --r 1 --tolerance 2'; do dipole eval $one || echo $?; done
1
1
1
1
! dipole eval: model better: bad-value: cos_in: allowed: 0 to 1 (--cos-in)
! dipole eval: model better: bad-value: cos_out: allowed: a number; a parameter that is not wanted is left out (--cos-out)
! dipole eval: model better: bad-value: thickness: allowed: 0, a half space, with this model: transport and multipoles take slabs (--thickness)
! dipole eval: model better: bad-value: tolerance: allowed: 1e-12 to 1 (--tolerance)

$ dipole eval --sigma-a 0.032 --sigma-s 0.74 --g 0.5 --r 1 --model single,better,classical | grep note
model      channel  sigma_a  sigma_s    g  eta     albedo  numerical error  model error  numerical error  model error  evaluator       notes
note: similarity: g is not 0: the model uses isotropic scattering with sigma_s (1 - g)

$ dipole eval --sigma-a 0.032 --sigma-s 0.74 --g 0.5 --r 1 --model better | grep note
model   channel  sigma_a  sigma_s    g  eta    albedo  numerical error  model error  numerical error  model error  evaluator       notes
note: similarity: g is not 0: the model uses isotropic scattering with sigma_s (1 - g)

## Errors: not solved, and what diverges at r = 0.
$ dipole eval --sigma-a 0.03 --sigma-s 1 --eta 5 --model classical --wanted albedo --r 1
moments exact, R in 1/mm^2 per unit of power that entered

model      channel  sigma_a  sigma_s  g  eta    albedo  numerical error  model error  evaluator  notes
                       1/mm     1/mm                 1
---------  -------  -------  -------  -  ---  --------  ---------------  -----------  ---------  -----
classical  1           0.03        1  0    5  0.361207          2.8e-15   not solved        f64
numerical error: at most, against the model's formula
model error: the largest, of the model against radiative transport
errors are relative, but of ln R, its derivatives, paths and modulated light absolute, as the
cdf's model error is, and of R_f over the albedo
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.555556 (eta 5)

$ dipole eval --sigma-a 0.03 --sigma-s 1 --model better --wanted R --r 0
moments exact, R in 1/mm^2 per unit of power that entered

        better
 r         R 1
mm      1/mm^2
--  ----------
 0  4.9723e-02

model   channel  sigma_a  sigma_s  g  eta  numerical error  model error  evaluator  notes
                    1/mm     1/mm
------  -------  -------  -------  -  ---  ---------------  -----------  ---------  -----
better  1           0.03        1  0  1.3          2.3e-15     diverges        f64
numerical error: at most, against the model's formula
model error: the largest, of the model against radiative transport, at r > 0: transport diverges at r = 0
errors are relative, but of ln R, its derivatives, paths and modulated light absolute, as the
cdf's model error is, and of R_f over the albedo
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.982987 (eta 1.3)

$ dipole eval --sigma-a 0.03 --sigma-s 1 --model better --wanted R --r 0,1
moments exact, R in 1/mm^2 per unit of power that entered

        better
 r         R 1
mm      1/mm^2
--  ----------
 0  4.9723e-02
 1  2.2375e-02

model   channel  sigma_a  sigma_s  g  eta  numerical error  model error  evaluator  notes
                    1/mm     1/mm
------  -------  -------  -------  -  ---  ---------------  -----------  ---------  -----
better  1           0.03        1  0  1.3          2.8e-15      1.3e-01        f64
numerical error: at most, against the model's formula, at r = 0 to 1 mm
model error: the largest, of the model against radiative transport, at r > 0: transport diverges at r = 0
errors are relative, but of ln R, its derivatives, paths and modulated light absolute, as the
cdf's model error is, and of R_f over the albedo
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.982987 (eta 1.3)

$ dipole eval --sigma-a 0.03 --sigma-s 1 --model transport --wanted R,2_pi_r_R --r 0,1
moments exact, R in 1/mm^2 per unit of power that entered

     transport   transport
 r         R 1  2_pi_r_R 1
mm      1/mm^2        1/mm
--  ----------  ----------
 0         inf  3.6900e-01
 1  1.9787e-02  1.2433e-01

                                                            R            R         2_pi_r_R     2_pi_r_R
model      channel  sigma_a  sigma_s  g  eta  numerical error  model error  numerical error  model error  evaluator  notes
                       1/mm     1/mm
---------  -------  -------  -------  -  ---  ---------------  -----------  ---------------  -----------  ---------  -----
transport  1           0.03        1  0  1.3          8.5e-05      0.0e+00          8.5e-05      0.0e+00        lut
numerical error: at most, against the model's formula, at r = 0 to 1 mm
model error: the largest, of the model against radiative transport
errors are relative, but of ln R, its derivatives, paths and modulated light absolute, as the
cdf's model error is, and of R_f over the albedo
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.982987 (eta 1.3)

## What all models refuse is said once, and who refuses by itself is left out.
$ dipole eval --sigma-a 0.032 --sigma-s 0.74 --model all --cos-in 2
! dipole eval: bad-value: cos_in: allowed: 0 to 1 (--cos-in)
? 1

$ dipole eval --sigma-a 0.032 --sigma-s 0.74 --model all --eta 0
! dipole eval: bad-value: eta: allowed: 0.001 to 1000 (--eta)
? 1

$ dipole eval --sigma-a 0.032 --sigma-s 0.74 --model all --r 1 --wanted R --format csv 2>&1 >all.csv | cut -d' ' -f3
multipole
multipole-transmitted
better-multipole
better-multipole-transmitted
transport-transmitted

$ cut -d, -f1 all.csv | sort -u | wc -l
26

$ dipole eval --sigma-a 0.032 --sigma-s 0.74 --model all --r 0,1 --wanted R --format csv 2>&1 >zero.csv | cut -d' ' -f3,7-
gaussians bad-value: r number 1 of 2: allowed: the radii that the fit covers: fit_from to fit_to (--r)
multipole bad-value: thickness: allowed: above 0 mm: this model is of a slab (--thickness)
multipole-transmitted bad-value: thickness: allowed: above 0 mm: this model is of a slab (--thickness)
better-multipole bad-value: thickness: allowed: above 0 mm: this model is of a slab (--thickness)
better-multipole-transmitted bad-value: thickness: allowed: above 0 mm: this model is of a slab (--thickness)
transport-transmitted bad-value: thickness: allowed: above 0 mm: light leaves below this model's last layer (--thickness)

$ cut -d, -f1 zero.csv | sort -u | wc -l
25

## A model that does not take a parameter is left out, too: no value is without it.
$ dipole eval --sigma-a 0.032 --sigma-s 0.74 --model all --r 1 --thickness 5 --tolerance 0.1 --wanted R --format csv 2>left | grep -v ^transport
model,channel,sigma_a,sigma_s,g,eta,thickness,r,R,numerical_error,model_error,evaluator,notes
multipole,1,0.032,0.74,0,1.3,5,1,0.02194858849201655,0.10000000000001509,,f64,
multipole-transmitted,1,0.032,0.74,0,1.3,5,1,0.0038209978342304434,0.100000000000016,,f64,
better-multipole,1,0.032,0.74,0,1.3,5,1,0.015417005063644533,0.1000000000000151,,f64,
better-multipole-transmitted,1,0.032,0.74,0,1.3,5,1,0.0029863388761399183,0.10000000000001603,,f64,

$ head -n 1 left; wc -l <left
dipole eval: classical is left out: bad-value: thickness: allowed: 0, a half space, with this model: transport and multipoles take slabs (--thickness)
24

$ dipole eval --sigma-a 0.032 --sigma-s 0.74 --model all --r 1 --gamma 1 --wanted R --format csv 2>/dev/null
model,channel,sigma_a,sigma_s,g,eta,r,R,numerical_error,model_error,evaluator,notes
transport,1,0.032,0.74,0,1.3,1,0.01570149,8.30018799703575e-5,,lut,gamma

$ dipole eval --sigma-a 0.032 --sigma-s 0.74 --r 1 --model all,multipole
! dipole eval: model multipole: bad-value: thickness: allowed: above 0 mm: this model is of a slab (--thickness)
? 1

$ dipole eval --sigma-a 0.032 --sigma-s 0.74 --r 1 --model all,better --thickness 3
! dipole eval: model better: bad-value: thickness: allowed: 0, a half space, with this model: transport and multipoles take slabs (--thickness)
? 1

$ dipole eval --layer 2,5,0.8,1.4,0.05 --layer 0.1,10,0.8,1.4 --model transport --evaluator f64 --tolerance 0.1 --r 1,2 --format csv
model,channel,layers,r,R,albedo,numerical_error,model_error,numerical_error_R,model_error_R,numerical_error_albedo,model_error_albedo,evaluator,notes
transport,1,"2,5,0.8,1.4,0.05 0.1,10,0.8,1.4",1,0.016835318686629467,0.25048023025180277,0.003424872195986167,0,0.003424872195986167,0,2.7029064947531624e-8,0,f64,
transport,1,"2,5,0.8,1.4,0.05 0.1,10,0.8,1.4",2,0.0030647843782719048,0.25048023025180277,0.003424872195986167,0,0.003424872195986167,0,2.7029064947531624e-8,0,f64,

$ dipole eval --model transport $(for i in 1 2 3 4 5 6 7 8 9; do echo --layer 1,1,0,1.4,1; done)
! dipole eval: --layer: 9 layers: give at most 8
! `dipole eval --help` says more.
? 2

$ dipole eval --model better --sigma-a 0 --sigma-s 1 --r 1,1.,.5,+2,1E3,1e+3,1e-400,inf,Infinity,0.1000000000000000055511151231257827
moments exact, R in 1/mm^2 per unit of power that entered

          better
   r         R 1
  mm      1/mm^2
----  ----------
   1  2.6974e-02
   1  2.6974e-02
 0.5  4.3194e-02
   2  1.1273e-02
1000  4.0749e-10
1000  4.0749e-10
   0  5.4591e-02
 inf  0.0000e+00
 inf  0.0000e+00
 0.1  5.4015e-02

                                                                 R            R           albedo       albedo
model   channel  sigma_a  sigma_s  g  eta  albedo  numerical error  model error  numerical error  model error  evaluator  notes
                    1/mm     1/mm               1
------  -------  -------  -------  -  ---  ------  ---------------  -----------  ---------------  -----------  ---------  -----
better  1              0        1  0  1.3       1          1.8e-15      8.8e-01          1.8e-15      9.2e-06        f64
numerical error: at most, against the model's formula, at r = 0 to 1000 mm
model error: the largest, of the model against radiative transport, at r > 0: transport diverges at r = 0
errors are relative, but of ln R, its derivatives, paths and modulated light absolute, as the
cdf's model error is, and of R_f over the albedo
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.982987 (eta 1.3)

$ dipole eval --model transport --sigma-a 0.01 --sigma-s 10 --g 0.9 --eta 1.4 --from 1 --to 4 --deadline-ms 1; dipole eval --sigma-a 0.01 --sigma-s 10 --count 2 --deadline-ms 4294967295 --format csv
model,channel,sigma_a,sigma_s,g,eta,r,R,albedo,numerical_error,model_error,numerical_error_R,model_error_R,numerical_error_albedo,model_error_albedo,evaluator,notes
transport,1,0.01,10,0,1.3,0,inf,0.8716417198319318,8.569430525910252e-5,0,8.569430525910252e-5,0,8.569430525910252e-5,0,lut,
transport,1,0.01,10,0,1.3,10,1.0940608e-6,0.8716417198319318,8.569430525910252e-5,0,8.569430525910252e-5,0,8.569430525910252e-5,0,lut,
! dipole eval: deadline: the reply would come later than the deadline: deadline_ms: allowed: more milliseconds, or 0 for no limit (--deadline-ms)

$ for one in '--tolerance 1e-9' '--tolerance 2' '--tolerance .1 --eta 0' '--tolerance .1 --r 1,-1' '--tolerance .1 --from 3 --to 1' '--tolerance 1e-5 --wanted ln_R --g .9'; do dipole eval --sigma-a .032 --sigma-s .74 $one || echo $?; done
1
1
1
1
1
1
! dipole eval: bad-value: tolerance: allowed: at least 3.22e-06 (best: transport, f64) (--tolerance)
! dipole eval: bad-value: tolerance: allowed: 1e-12 to 1 (--tolerance)
! dipole eval: bad-value: eta: allowed: 0.001 to 1000 (--eta)
! dipole eval: bad-value: r number 2 of 2: allowed: 0 to infinity, in mm (--r)
! dipole eval: bad-value: radius_stop: allowed: at least radius_start, finite (--to)
! dipole eval: bad-value: tolerance: allowed: at least 0.000101 (best: transport, solved) (--tolerance)

$ printf '1.0\n1\n' > a.mci; printf '1.0\n1\na.mco A\n1\n.1 .1\n1 1 1\n9\n1\n' > b.mci; printf '1.0\n1\na.mco A\n1\n.1 .1\n1 1 1\n1\n1\n1.4 1 10 .8 .1 5\n' > c.mci; for i in a b c; do dipole eval --mci $i.mci || echo $?; done
1
1
1
! dipole eval: a.mci:2: a run is missing: expected the name of its output file
! dipole eval: b.mci:8: 9 layers: allowed: 1 to 8
! dipole eval: c.mci:9: '1.4 1 10 .8 .1 5': expected n, mua, mus, g and d of a layer, in cm

$ dipole eval --layer 0,1,0,1.4,1.01e-4 --layer 0,1e-6,0,1.4 --r 1 --tolerance 1
! dipole eval: bad-value: thickness of layer 1 of medium 1: allowed: thicker layers: R of these is not found; mc walks them (--layer)
? 1

$ dipole eval --model transport-transmitted --layer 4,1,0,1.4,1e-4 --layer 0,100,.99,1.4,9e3 --r 1 --tolerance 1
! dipole eval: model transport-transmitted: bad-value: thickness of layer 1 of medium 1: allowed: other layers: T of these is not found; mc walks them (--layer)
? 1
