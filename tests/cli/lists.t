## dipole media, info, table, bench and texture: what does not depend on the machine.
$ dipole media
medium       channel  sigma_a  sigma_s  g  eta                                               layers
                         1/mm     1/mm
-----------  -------  -------  -------  -  ---  ---------------------------------------------------
apple        red        0.003     2.29  0  1.3
             green     0.0034     2.39  0  1.3
             blue       0.046     1.97  0  1.3
chicken1     red        0.015     0.15  0  1.3
             green      0.077     0.21  0  1.3
             blue        0.19     0.38  0  1.3
chicken2     red        0.018     0.19  0  1.3
             green      0.088     0.25  0  1.3
             blue         0.2     0.32  0  1.3
cream        red       0.0002     7.38  0  1.3
             green     0.0028     5.47  0  1.3
             blue      0.0163     3.15  0  1.3
ketchup      red        0.061     0.18  0  1.3
             green       0.97     0.07  0  1.3
             blue        1.45     0.03  0  1.3
marble       red       0.0021     2.19  0  1.3
             green     0.0041     2.62  0  1.3
             blue      0.0071        3  0  1.3
potato       red       0.0024     0.68  0  1.3
             green      0.009      0.7  0  1.3
             blue        0.12     0.55  0  1.3
skimmilk     red       0.0014      0.7  0  1.3
             green     0.0025     1.22  0  1.3
             blue      0.0142      1.9  0  1.3
skin-dark    red                                  0.505,26.85,0.797,1.4,0.06 0.0341,17.25,0.797,1.4
             green                              0.689,27.89,0.7795,1.4,0.06 0.0727,18.16,0.7795,1.4
             blue                                   1.21,30.69,0.753,1.4,0.06 0.136,20.46,0.753,1.4
skin-light   red                                  0.282,26.85,0.797,1.4,0.06 0.0361,17.25,0.797,1.4
             green                               0.385,27.89,0.7795,1.4,0.06 0.124,18.16,0.7795,1.4
             blue                                  0.688,30.69,0.753,1.4,0.06 0.189,20.46,0.753,1.4
skin-medium  red                                  0.362,26.85,0.797,1.4,0.06 0.0366,17.25,0.797,1.4
             green                               0.494,27.89,0.7795,1.4,0.06 0.141,18.16,0.7795,1.4
             blue                                  0.875,30.69,0.753,1.4,0.06 0.206,20.46,0.753,1.4
skin1        red        0.032     0.74  0  1.3
             green       0.17     0.88  0  1.3
             blue        0.48     1.01  0  1.3
skin2        red        0.013     1.09  0  1.3
             green       0.07     1.59  0  1.3
             blue       0.145     1.79  0  1.3
spectralon   red            0     11.6  0  1.3
             green          0     20.4  0  1.3
             blue           0     14.9  0  1.3
wholemilk    red       0.0011     2.55  0  1.3
             green     0.0024     3.21  0  1.3
             blue       0.014     3.77  0  1.3

$ dipole media --format csv | grep skin1
skin1,red,0.032,0.74,0,1.3,
skin1,green,0.17,0.88,0,1.3,
skin1,blue,0.48,1.01,0,1.3,

$ dipole media --format json | head -5
{
  "units": {"sigma_a": "1/mm", "sigma_s": "1/mm"},
  "rows": [
    {"medium": "apple", "channel": "red", "sigma_a": 3e-3, "sigma_s": 2.29, "g": 0, "eta": 1.3, "layers": ""},
    {"medium": "apple", "channel": "green", "sigma_a": 0.0034, "sigma_s": 2.39, "g": 0, "eta": 1.3, "layers": ""},

$ dipole info --format csv | grep '^models,better,\|^parameters\|^limits,max_frame'
models,better,"d'Eon 2012, Table 2"
parameters,tolerance,"1: relative error: numerical if a model is named (lut: default 1e-4), else total (1e-12 to 1)"
parameters,cos_in,"1: cosine of the angle of incidence, for S; else 1 (0 to 1)"
parameters,cos_out,"1: cosine of the angle of exit, for S; else 1 (0 to 1)"
parameters,surface_albedo,"1: Burley's A; else the better dipole's albedo (0 to 1)"
parameters,gaussians,"1: number of Gaussians to fit, an integer; else 6 (1 to 12)"
parameters,fit_model,"id: model to fit; else better (1 to 65535)"
parameters,fit_from,"mm: least radius of a fit; else 0.1 mfp (0 to 1e30)"
parameters,fit_to,"mm: largest radius of a fit; else 10 mfp (1e-30 to 1e30)"
parameters,phase,"id: of mc: phase function; else henyey-greenstein (1 to 65535)"
parameters,phase_share,1: of mc with phase modified or two-term: share of the first HG (1e-6 to 1)
parameters,phase_g,1: of mc with phase two-term: mean cosine of the second HG (-0.9999 to 0.9999)
parameters,gamma,"1: (1 - g_2) / (1 - g) of the phase function, with transport; else 1 + g (0.5 to 1.95)"
parameters,detector_na,"1: of fit with transport, and of mc: sine of the largest detected exit angle; else 1 (0.01 to 1)"
parameters,eta_below,"1: with transport: index below a last layer of finite thickness; else 1 (0.25 to 4)"
parameters,derivative_layer,"1: with transport: number of the layer of dlnR_dln_*, an integer; else 1, the top one (1 to 8)"
parameters,index,"1: refractive index for the speed of light; else eta (0.25 to 8)"
parameters,mhz,MHz: frequency of modulated light (0 to 100000)
limits,max_frame_bytes,67108864

$ env -u DIPOLED dipole info | head -9 | grep -v 'instruction_set\|protocol'
section         name                                value
--------------  ----------------------------------  ------------------------------------------------------------------------------------------------
daemon          software                            dipoled 0.1.0
                address                             private:
                workers                             2
                R_unit                              1/mm^2 per unit of power that entered
models          classical                           Jensen et al. 2001; d'Eon 2012, Table 2

$ dipole table --medium skin1 --model transport --tolerance 1e-3
skin1, model transport, moments exact, tolerance 0.001

channel  sigma_a  sigma_s  g  eta    albedo  pieces from   to  bytes    numerical error  holds up to   model error
            1/mm     1/mm                             mm   mm         relative, at most           mm  at all radii
-------  -------  -------  -  ---  --------  -----------  ---  -----  -----------------  -----------  ------------
red        0.032     0.74  0  1.3  0.439458    5.821e-11  512  19208            7.6e-04        111.1       0.0e+00
green       0.17     0.88  0  1.3  0.213259     2.91e-11  256  19192            8.0e-04        43.72       0.0e+00
blue        0.48     1.01  0  1.3  0.115435     2.91e-11  128  19128            7.4e-04        23.63       0.0e+00
numerical error: of R and cdf against the model's formula, as measured
holds up to: the numerical error of R is larger at radii beyond this one
model error: of the model against radiative transport
libdipole and the Python module state both errors for the radii that they evaluate
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.982987 (eta 1.3)

$ dipole table --sigma-a 0.032 --sigma-s 0.74 --model better --g 0.97 --output a.table --format csv
channel,sigma_a,sigma_s,g,eta,albedo,pieces_from,pieces_to,bytes,numerical_error,reach,model_error
1,0.032,0.74,0.97,1.3,0.01747984589212022,9.313225746154785e-10,2048,21656,8.439217715535063e-5,inf,

$ dipole table --sigma-a 0.032 --sigma-s 0.74 --output - --format json
! dipole table: --output - writes binary to standard output: leave --format out, or name a file
! `dipole table --help` says more.
? 2

$ dipole table --sigma-a 0.032 --sigma-s 0.74 --output /nonexistent/file
! dipole table: cannot write /nonexistent/file: No such file or directory
? 1

$ dipole table --sigma-a 0.032 --sigma-s 0.74 --output /dev/full
! dipole table: cannot write /dev/full: No space left on device
? 1

$ (trap '' XFSZ; ulimit -f 8; dipole table --sigma-a 0.032 --sigma-s 0.74 --output part.table); test -e part.table || echo none
none
! dipole table: cannot write part.table: File too large

$ dipole table --sigma-a 0.032 --sigma-s 0.74 --tolerance 1e-9
! dipole table: bad-value: tolerance: allowed: 1e-6 to 1 with lut (--tolerance)
? 1

$ dipole table --sigma-a 0.032 --sigma-s 0.74 --g 0,1
! dipole table: channel 2: bad-value: g: allowed: between -1 and 1, exclusive (--g)
? 1

$ dipole table --sigma-a 0.032 --sigma-s 0.74 --thickness 1 --model better
! dipole table: bad-value: thickness: allowed: 0, a half space, with this model: transport and multipoles take slabs (--thickness)
? 1

$ for one in '--seconds 0' '--in-flight 4097' '--radii 0' '--connections 257' '--connections 64 --in-flight 64 --radii 65536'; do dipole bench $one || echo $?; done
2
2
2
2
2
! dipole bench: --seconds: give a number from 0.01 to 3600
! `dipole bench --help` says more.
! dipole bench: --in-flight: give a number from 1 to 4096
! `dipole bench --help` says more.
! dipole bench: --radii: give a number from 1 to 4194304
! `dipole bench --help` says more.
! dipole bench: --connections: give a number from 1 to 256
! `dipole bench --help` says more.
! dipole bench: --connections, --in-flight, --radii: give less: their product is at most 33554432
! `dipole bench --help` says more.

$ dipole bench --seconds .01 --model multipole
! dipole bench: bad-value: thickness of medium 1 of 3: allowed: above 0 mm: this model is of a slab (--thickness)
? 1

$ dipole complete 'dipole '
eval	Evaluate a medium over a range of radii, as a table or a picture
plot	Draw profiles over r, and how far they are from radiative transport
points	Evaluate each row of a CSV file (or of standard input)
sample	Draw radii in proportion to the light that leaves there
invert	Find the medium that has a given albedo: sigma_a and sigma_s
fit	Find sigma_a and sigma_s' of samples from readings of their reflectance
texture	Map an image of colours to images of the media that have them
convert	Convert colours and lengths between renderers, and to coefficients
bake	Bake kernels, lengths and tables of a medium for engines, with their errors
gather	Sum the light that points leave at other positions
table	Fetch tables of a medium, to be evaluated without a daemon
mc	Walk photons through a medium (Monte Carlo): R(r) with standard errors
tissue	Show the coefficients of a tissue at wavelengths, or list tissues
media	List the media with names: their coefficients, or layers
info	Show a daemon: models, evaluators, instruction set, limits, statistics
bench	Measure how fast a daemon replies: latency, pipelined requests, throughput
help

$ dipole complete 'dipole help ta'
table	Fetch tables of a medium, to be evaluated without a daemon

$ dipole complete 'dipole nonsense '

$ dipole complete 'dipole eval --sigma-'
--sigma-a	absorption coefficient, 1/mm
--sigma-s	scattering coefficient, 1/mm

$ dipole complete 'dipole eval --log --cos-o'
--cos-out	cosine of the angle of exit, for S

$ dipole complete 'dipole eval --wanted R,al'
R,albedo

$ dipole complete 'dipole eval --medium=skin'
--medium=skin-dark
--medium=skin-light
--medium=skin-medium
--medium=skin1
--medium=skin2

$ dipole complete 'dipole mc --channel '
red
green
blue

$ dipole complete 'dipole mc --phase '
henyey-greenstein
modified
two-term

$ dipole complete 'dipole info --format '
table
csv
json

$ dipole complete 'dipole info --connect t'
tcp:
tls:

$ dipole complete 'dipole points '

$ dipole complete 'dipole eval --to '
