## dipole mc: Monte Carlo.
$ dipole mc --medium skin1 --channel red --photons 2e4 --to 4 --rings 4
Monte Carlo, ended by photons, photons 20480, error of the total R 0.0056, largest error of a ring 0.043

skin1, channel red, sigma_a 0.032, sigma_s 0.74, g 0, eta 1.3, seed 1, photons 20480

albedo    quantity       from  to         value    error  relative  photons
                           mm  mm        1/mm^2   1/mm^2
--------  -------------  ----  --  ------------  -------  --------  -------
0.958549  R                 0   1   4.56523e-02  1.9e-04    0.42 %     3328
0.958549  R                 1   2   8.88924e-03  1.4e-04     1.6 %     2266
0.958549  R                 2   3   3.67740e-03  6.7e-05     1.8 %     1772
0.958549  R                 3   4   1.95821e-03  8.5e-05     4.3 %     1454
0.958549  R_total                   4.35942e-01  2.4e-03    0.56 %
0.958549  R_unscattered             0.00000e+00  0.0e+00         -
0.958549  R_under                   0.00000e+00  0.0e+00         -
0.958549  R_over                    1.07914e-01  1.6e-03     1.5 %
0.958549  absorbed                  5.62546e-01  2.1e-03    0.37 %
0.958549  unfinished                0.00000e+00  0.0e+00         -
0.958549  roulette                 -1.51178e-03  6.9e-04         -
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.982987 (eta 1.3)
under, over: within the first ring's inner edge, and beyond the last ring; unscattered: at
r = 0; unfinished: walks that were cut off; roulette: added by it, about 0. These and the
totals are shares of the power that entered.

$ dipole mc --sigma-a 0.1 --sigma-s 0.9 --photons 2e4 --from 0.5 --to 4 --rings 2 --thickness 2 --albedo 0.5,0.9
Monte Carlo, ended by photons, photons 20480, error of the total R 0.0091, largest error of a ring 0.078

channel 1, sigma_a 0.1, sigma_s 0.9, g 0, eta 1.3, thickness 2, seed 1, photons 20480

albedo  quantity       from    to         value    error  relative  photons
                         mm    mm        1/mm^2   1/mm^2
------  -------------  ----  ----  ------------  -------  --------  -------
0.5     R               0.5  2.25   1.30426e-03  2.3e-05     1.8 %     4568
0.5     R              2.25     4   7.18199e-05  3.4e-06     4.7 %     2066
0.5     T               0.5  2.25   1.29194e-03  1.8e-05     1.4 %     4091
0.5     T              2.25     4   7.02700e-05  5.5e-06     7.8 %     2068
0.5     R_total                     6.27550e-02  5.7e-04    0.91 %
0.5     R_unscattered               3.06308e-04  0.0e+00       0 %
0.5     R_under                     3.96105e-02  3.6e-04    0.91 %
0.5     R_over                      6.51332e-04  9.0e-05      14 %
0.5     T_total                     1.68779e-01  4.8e-04    0.28 %
0.5     T_unscattered               1.33033e-01  0.0e+00       0 %
0.5     T_under                     1.31702e-02  4.0e-04       3 %
0.5     T_over                      6.27877e-04  3.8e-05     6.1 %
0.5     absorbed                    7.68466e-01  7.1e-04   0.092 %
0.5     unfinished                  0.00000e+00  0.0e+00         -
0.5     roulette                   -7.70434e-10  5.1e-09         -
0.9     R               0.5  2.25   7.58699e-03  9.4e-05     1.2 %     4568
0.9     R              2.25     4   1.12109e-03  2.2e-05       2 %     2066
0.9     T               0.5  2.25   6.79020e-03  9.4e-05     1.4 %     4091
0.9     T              2.25     4   1.09995e-03  4.2e-05     3.8 %     2068
0.9     R_total                     2.65350e-01  1.3e-03    0.47 %
0.9     R_unscattered               3.06308e-04  0.0e+00       0 %
0.9     R_under                     9.25520e-02  5.5e-04    0.59 %
0.9     R_over                      1.92629e-02  3.1e-04     1.6 %
0.9     T_total                     3.29450e-01  1.0e-03    0.31 %
0.9     T_unscattered               1.33033e-01  0.0e+00       0 %
0.9     T_under                     3.56551e-02  9.2e-04     2.6 %
0.9     T_over                      2.03050e-02  3.4e-04     1.7 %
0.9     absorbed                    4.05027e-01  1.0e-03    0.26 %
0.9     unfinished                  0.00000e+00  0.0e+00         -
0.9     roulette                   -1.73285e-04  3.5e-04         -
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.982987 (eta 1.3)
under, over: within the first ring's inner edge, and beyond the last ring; unscattered: at
r = 0; unfinished: walks that were cut off; roulette: added by it, about 0. These and the
totals are shares of the power that entered.

$ dipole mc --sigma-a 0.1 --sigma-s 0.9 --photons 2e4 --to 4 --rings 2 --format csv
channel,sigma_a,sigma_s,g,eta,albedo,quantity,from,to,value,error,photons
1,0.1,0.9,0,1.3,0.9,R,0,2,0.0165230439074756,1.7978604881144274e-4,6421
1,0.1,0.9,0,1.3,0.9,R,2,4,0.0014753148717933367,3.53779751191746e-5,2833
1,0.1,0.9,0,1.3,0.9,R_total,,,0.2887791768680572,0.0019652241353313826,
1,0.1,0.9,0,1.3,0.9,R_unscattered,,,0,0,
1,0.1,0.9,0,1.3,0.9,R_under,,,0,0,
1,0.1,0.9,0,1.3,0.9,R_over,,,0.025526423093895773,3.0426576573929447e-4,
1,0.1,0.9,0,1.3,0.9,absorbed,,,0.7099982207484454,0.0014326138401066113,
1,0.1,0.9,0,1.3,0.9,unfinished,,,0,0,
1,0.1,0.9,0,1.3,0.9,roulette,,,-0.0012226023835014983,7.332947458397996e-4,

$ dipole mc --sigma-a 0.1 --sigma-s 0.9 --photons 2e4 --to 4 --rings 1 --g 0.5 --phase two-term --phase-share 0.8 --phase-g -0.2 --detector-na 0.5 --format json
{
  "software": "dipoled 0.1.0",
  "ended_by": "photons",
  "photons": 20480,
  "error_total": 0.008743218792484419,
  "error_rings": 0.049223969385662224,
  "units": {"sigma_a": "1/mm", "sigma_s": "1/mm", "from": "mm", "to": "mm"},
  "rows": [
    {"channel": "1", "sigma_a": 0.1, "sigma_s": 0.9, "g": 0.5, "eta": 1.3, "phase": "two-term", "phase_share": 0.8, "phase_g": -0.2, "detector_na": 0.5, "seed": 1, "albedo": 0.9, "quantity": "R", "from": 0, "to": 4, "value": 7.690786025338378e-4, "error": 3.7857101586293516e-5, "photons": 1428},
    {"channel": "1", "sigma_a": 0.1, "sigma_s": 0.9, "g": 0.5, "eta": 1.3, "phase": "two-term", "phase_share": 0.8, "phase_g": -0.2, "detector_na": 0.5, "seed": 1, "albedo": 0.9, "quantity": "R_total", "from": null, "to": null, "value": 0.18982922189587037, "error": 0.0016597184202426685, "photons": null},
    {"channel": "1", "sigma_a": 0.1, "sigma_s": 0.9, "g": 0.5, "eta": 1.3, "phase": "two-term", "phase_share": 0.8, "phase_g": -0.2, "detector_na": 0.5, "seed": 1, "albedo": 0.9, "quantity": "R_unscattered", "from": null, "to": null, "value": 0, "error": 0, "photons": null},
    {"channel": "1", "sigma_a": 0.1, "sigma_s": 0.9, "g": 0.5, "eta": 1.3, "phase": "two-term", "phase_share": 0.8, "phase_g": -0.2, "detector_na": 0.5, "seed": 1, "albedo": 0.9, "quantity": "R_under", "from": null, "to": null, "value": 0, "error": 0, "photons": null},
    {"channel": "1", "sigma_a": 0.1, "sigma_s": 0.9, "g": 0.5, "eta": 1.3, "phase": "two-term", "phase_share": 0.8, "phase_g": -0.2, "detector_na": 0.5, "seed": 1, "albedo": 0.9, "quantity": "R_over", "from": null, "to": null, "value": 0.008992183059849699, "error": 3.6129985936219716e-4, "photons": null},
    {"channel": "1", "sigma_a": 0.1, "sigma_s": 0.9, "g": 0.5, "eta": 1.3, "phase": "two-term", "phase_share": 0.8, "phase_g": -0.2, "detector_na": 0.5, "seed": 1, "albedo": 0.9, "quantity": "absorbed", "from": null, "to": null, "value": 0.809548156283373, "error": 0.0015261491139638408, "photons": null},
    {"channel": "1", "sigma_a": 0.1, "sigma_s": 0.9, "g": 0.5, "eta": 1.3, "phase": "two-term", "phase_share": 0.8, "phase_g": -0.2, "detector_na": 0.5, "seed": 1, "albedo": 0.9, "quantity": "unfinished", "from": null, "to": null, "value": 0, "error": 0, "photons": null},
    {"channel": "1", "sigma_a": 0.1, "sigma_s": 0.9, "g": 0.5, "eta": 1.3, "phase": "two-term", "phase_share": 0.8, "phase_g": -0.2, "detector_na": 0.5, "seed": 1, "albedo": 0.9, "quantity": "roulette", "from": null, "to": null, "value": -6.226218207645504e-4, "error": 4.069310037447945e-4, "photons": null}
  ]
}

$ dipole mc --medium skin1,marble --channel blue --g 0.8 --photons 2000 --rings 1 --format csv
channel,sigma_a,sigma_s,g,eta,albedo,quantity,from,to,value,error,photons
skin1 blue,0.48,5.050000000000001,0.8,1.3,0.9132007233273055,R,0,10,2.9391405385892995e-4,inf,1052
skin1 blue,0.48,5.050000000000001,0.8,1.3,0.9132007233273055,R_total,,,0.09233582323900091,inf,
skin1 blue,0.48,5.050000000000001,0.8,1.3,0.9132007233273055,R_unscattered,,,0,0,
skin1 blue,0.48,5.050000000000001,0.8,1.3,0.9132007233273055,R_under,,,0,inf,
skin1 blue,0.48,5.050000000000001,0.8,1.3,0.9132007233273055,R_over,,,0,inf,
skin1 blue,0.48,5.050000000000001,0.8,1.3,0.9132007233273055,absorbed,,,0.9099435971869859,inf,
skin1 blue,0.48,5.050000000000001,0.8,1.3,0.9132007233273055,unfinished,,,0,inf,
skin1 blue,0.48,5.050000000000001,0.8,1.3,0.9132007233273055,roulette,,,0.002279420425995214,inf,
marble blue,0.0071,15.000000000000004,0.8,1.3,0.9995268906051136,R,0,10,0.002603024782703812,inf,3733
marble blue,0.0071,15.000000000000004,0.8,1.3,0.9995268906051136,R_total,,,0.8234509051047858,inf,
marble blue,0.0071,15.000000000000004,0.8,1.3,0.9995268906051136,R_unscattered,,,0,0,
marble blue,0.0071,15.000000000000004,0.8,1.3,0.9995268906051136,R_under,,,0,inf,
marble blue,0.0071,15.000000000000004,0.8,1.3,0.9995268906051136,R_over,,,0.00568655165933924,inf,
marble blue,0.0071,15.000000000000004,0.8,1.3,0.9995268906051136,absorbed,,,0.17681562950160762,inf,
marble blue,0.0071,15.000000000000004,0.8,1.3,0.9995268906051136,unfinished,,,0,inf,
marble blue,0.0071,15.000000000000004,0.8,1.3,0.9995268906051136,roulette,,,2.665346063933015e-4,inf,

$ dipole mc --sigma-a 0.02,0.1 --sigma-s 10 --g 0.9 --eta 1.4 --r 1,2 --photons 2e4 --format csv
sample,channel,sigma_a,sigma_s,g,eta,r,R,error
1,1,0.02,10,0.9,1.4,1,0.01951816904341955,0.0011803849975312952
1,1,0.02,10,0.9,1.4,2,0.00865045900648739,4.926673118399016e-4
2,2,0.1,10,0.9,1.4,1,0.012046688398935086,0.0010656090405767702
2,2,0.1,10,0.9,1.4,2,0.004236130842936714,1.9365225033346625e-4

$ dipole mc --sigma-a 0.1 --sigma-s 0.9 --error 0.05 --to 3 --rings 3 --format csv
channel,sigma_a,sigma_s,g,eta,albedo,quantity,from,to,value,error,photons
1,0.1,0.9,0,1.3,0.9,R,0,1,0.04590471378682582,2.3170241487721353e-4,25373
1,0.1,0.9,0,1.3,0.9,R,1,2,0.006804410511629082,6.67372467768142e-5,15742
1,0.1,0.9,0,1.3,0.9,R,2,3,0.0022708512293433867,2.0215656838869837e-5,10864
1,0.1,0.9,0,1.3,0.9,R_total,,,0.2907800395821985,6.983862531190143e-4,
1,0.1,0.9,0,1.3,0.9,R_unscattered,,,0,0,
1,0.1,0.9,0,1.3,0.9,R_under,,,0,0,
1,0.1,0.9,0,1.3,0.9,R_over,,,0.04676562206083168,3.3598952634447915e-4,
1,0.1,0.9,0,1.3,0.9,absorbed,,,0.7090884037130718,6.339023556806285e-4,
1,0.1,0.9,0,1.3,0.9,unfinished,,,0,0,
1,0.1,0.9,0,1.3,0.9,roulette,,,-1.315567047330185e-4,2.1399659711909382e-4,

$ dipole mc --sigma-a 0.1 --sigma-s 0.9 --photons 2e4 --to 4 --rings 1 --error 0.001
Monte Carlo, ended by photons, photons 20480, error of the total R 0.0068, largest error of a ring 0.0082

channel 1, sigma_a 0.1, sigma_s 0.9, g 0, eta 1.3, seed 1, photons 20480

albedo  quantity       from  to         value    error  relative  photons
                         mm  mm        1/mm^2   1/mm^2
------  -------------  ----  --  ------------  -------  --------  -------
0.9     R                 0   4   5.23725e-03  4.3e-05    0.82 %     9254
0.9     R_total                   2.88779e-01  2.0e-03    0.68 %
0.9     R_unscattered             0.00000e+00  0.0e+00         -
0.9     R_under                   0.00000e+00  0.0e+00         -
0.9     R_over                    2.55264e-02  3.0e-04     1.2 %
0.9     absorbed                  7.09998e-01  1.4e-03     0.2 %
0.9     unfinished                0.00000e+00  0.0e+00         -
0.9     roulette                 -1.22260e-03  7.3e-04         -
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.982987 (eta 1.3)
under, over: within the first ring's inner edge, and beyond the last ring; unscattered: at
r = 0; unfinished: walks that were cut off; roulette: added by it, about 0. These and the
totals are shares of the power that entered.
! dipole mc: 20480 photons were too few for the requested error: the worst ring has 0.0082, R has 0.0068: give more --photons
? 1

$ dipole mc --sigma-a 0.1 --sigma-s 0.9 --thickness 4 --r 1,2 --photons 2e4 --format csv | dipole fit
! dipole fit: standard input: the column thickness is of no medium that can be fitted: those are half spaces that scatter by Henyey-Greenstein's function
? 1

$ dipole mc --sigma-a 0.1 --sigma-s 0.9 --phase modified --phase-share 0.9 --r 1,2 --photons 2e4 --format csv | dipole fit
! dipole fit: standard input: the column phase is of no medium that can be fitted: those are half spaces that scatter by Henyey-Greenstein's function
? 1

$ dipole mc --sigma-a 0.1 --sigma-s 0.9 --error 0 --total-error 0 --format csv | grep -c total
1

$ for one in '' '--sigma-a 0.1 --sigma-s 0.9 --r 1 --to 2' '--sigma-a 0.1 --sigma-s 0.9 --r 0,1' '--medium skin1 --channel pink' '--sigma-a 1,2 --sigma-s 1,2,3' '--sigma-a 0.1 --sigma-s 0.9 --channel red' '--sigma-a 0.1 --sigma-s 0.9 --log' '--sigma-a 0.1 --sigma-s 0.9 --photons 1.5' '--sigma-a 0.1 --sigma-s 0.9 --rings 99999999999' '--sigma-a 0.1 --sigma-s 0.9 --phase mie'; do dipole mc $one || echo $?; done
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
! dipole mc: give --medium NAME, or --sigma-a and --sigma-s, or --layer
! `dipole mc --help` says more.
! dipole mc: --r gives the radii one by one: leave --from, --to, --rings and --log out
! `dipole mc --help` says more.
! dipole mc: --r: give radii above 0
! `dipole mc --help` says more.
! dipole mc: --channel: 'pink' is unknown; it is red, green or blue
! `dipole mc --help` says more.
! dipole mc: --sigma-s has 3 values and --sigma-a has 2: give one value or as many
! `dipole mc --help` says more.
! dipole mc: --channel is one of a measured medium: give --medium too
! `dipole mc --help` says more.
! dipole mc: --log needs --from, above 0
! `dipole mc --help` says more.
! dipole mc: --photons: give a whole number from 1 to 9e15, such as 2000000 or 2e6
! `dipole mc --help` says more.
! dipole mc: --rings: '99999999999' is no whole number up to 4294967295
! `dipole mc --help` says more.
! dipole mc: --phase: 'mie' is unknown; this daemon has henyey-greenstein, modified, two-term
! `dipole mc --help` says more.

$ for one in '--sigma-a 0.1 --sigma-s 0.9 --phase two-term --phase-share 0.8' '--sigma-a 0.1 --sigma-s 0.9 --g 1' '--sigma-a 0.1 --sigma-s 0.9 --thickness -1' '--sigma-a 0.1 --sigma-s 0.9 --albedo 0.5,2' '--sigma-a 0.1 --sigma-s 0.9 --albedo 1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1,1' '--sigma-a 0.1 --sigma-s 0.9 --rings 4097' '--sigma-a 0.1 --sigma-s 0.9 --from -1' '--sigma-a 0.1 --sigma-s 0.9 --error 2' '--sigma-a 0.1 --sigma-s 0.9 --total-error -1' '--sigma-a 0.1 --sigma-s 0.9 --photons 1e12' '--sigma-a 0.1 --sigma-s 0.9 --detector-na 1.1'; do dipole mc $one || echo $?; done
1
1
1
1
1
1
1
1
1
1
1
! dipole mc: bad-value: phase_g: allowed: -0.9999 to 0.9999: the phase function two-term needs it (--phase-g)
! dipole mc: bad-value: g: allowed: between -1 and 1, exclusive (--g)
! dipole mc: bad-value: thickness: allowed: 0 (a half space), or 1e-15 to 1e30 mm (--thickness)
! dipole mc: bad-value: albedo: allowed: 0 to 1 (--albedo)
! dipole mc: albedo_count is at most 16
! dipole mc: bad-count: ring_count: allowed: 1 to 4096 (--rings)
! dipole mc: bad-value: radius_start: allowed: at least 0 mm, finite (--from)
! dipole mc: bad-value: error_rings: allowed: 0 (none), or 1e-9 to 1 (--error)
! dipole mc: bad-value: error_total: allowed: 0 (none), or 1e-9 to 1 (--total-error)
! dipole mc: too-large: photons: allowed: at most 10000000000 photons (--photons)
! dipole mc: bad-value: detector_na: allowed: 0.01 to 1 (--detector-na)

$ dipole mc --layer 2,5,0.8,1.4,0.05 --layer 0.1,10,0.8,1.33,0.5 --eta-below 1.33 --photons 2e4 --to 2 --rings 1
Monte Carlo, ended by photons, photons 20480, error of the total R 0.015, largest error of a ring 0.015

channel 1, layers 2,5,0.8,1.4,0.05 0.1,10,0.8,1.33,0.5, eta_below 1.33, seed 1, photons 20480

albedo    quantity       from  to         value    error  relative  photons
                           mm  mm        1/mm^2   1/mm^2
--------  -------------  ----  --  ------------  -------  --------  -------
0.714286  R                 0   2   1.00472e-02  1.5e-04     1.5 %     4014
0.714286  T                 0   2   4.68019e-02  1.5e-04    0.33 %    15202
0.714286  R_total                   1.28844e-01  1.9e-03     1.5 %
0.714286  R_unscattered             3.17420e-04  0.0e+00       0 %
0.714286  R_under                   0.00000e+00  0.0e+00         -
0.714286  R_over                    2.26984e-03  1.5e-04     6.6 %
0.714286  T_total                   5.99398e-01  2.3e-03    0.39 %
0.714286  T_unscattered             4.51365e-03  0.0e+00       0 %
0.714286  T_under                   0.00000e+00  0.0e+00         -
0.714286  T_over                    6.75440e-03  5.4e-04       8 %
0.714286  absorbed                  2.71555e-01  9.6e-04    0.35 %
0.714286  unfinished                0.00000e+00  0.0e+00         -
0.714286  roulette                 -2.03172e-04  2.4e-04         -
0.714286  absorbed_1                1.84646e-01  8.7e-04    0.47 %
0.714286  absorbed_2                8.69089e-02  4.2e-04    0.49 %
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.972222 (eta 1.4)
under, over: within the first ring's inner edge, and beyond the last ring; unscattered: at
r = 0; unfinished: walks that were cut off; roulette: added by it, about 0. These and the
totals are shares of the power that entered.

$ for one in '--layer 1,2' '--layer 1,2,0,1.4 --layer 1,2,0,1.4' '--layer 1,2,0,1.4 --g 0.5'; do dipole mc $one || echo $?; done
2
2
2
! dipole mc: --layer 1,2: give SIGMA_A,SIGMA_S,G,ETA, and the thickness in mm of a layer that is no half space
! `dipole mc --help` says more.
! dipole mc: --layer 1,2,0,1.4: only the last layer may be a half space: add its thickness in mm
! `dipole mc --help` says more.
! dipole mc: --layer gives a layer whole: leave --medium, --channel, --sigma-a, --sigma-s, --g, --eta and --thickness out
! `dipole mc --help` says more.

$ dipole mc --layer 1,2,0,1.4,1 --layer 1,2,0,-1 --photons 1
! dipole mc: bad-value: eta of layer 2 of medium 1: allowed: 0.001 to 1000 (--layer)
? 1

$ dipole mc --layer 1,2,0,1.4,1 --layer 1,2,0,1.4 --albedo 0.5,0.6 --photons 1
! dipole mc: bad-value: albedo_count: allowed: 1: layers have an albedo each (--albedo)
? 1

## The same seed has the same output, whatever the daemon.
$ for seed in 5 5 6; do dipole mc --sigma-a 0.1 --sigma-s 0.9 --eta 1.3 --photons 2e4 --to 4 --rings 4 --format json --seed $seed > $seed; cat $seed >> all; done; DIPOLED_MC_THREADS=1 DIPOLED_ISA=portable dipole mc --sigma-a 0.1 --sigma-s 0.9 --eta 1.3 --photons 2e4 --to 4 --rings 4 --format json --seed 5 | cmp - 5 && cat 5 5 6 | cmp - all; cmp -s 5 6; echo $?
1
