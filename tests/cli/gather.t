## dipole gather: what points leave at queries.
$ printf 'x,y,z,power\n0,0,0,1\n1,0,0,0.5\n' > points.csv

$ printf '# three\nz,name,y,x\n1,a,0,0\n0.5,b,0,0\n0,c,2,0\n' > queries.csv

$ dipole gather points.csv queries.csv --sigma-a 0.032 --sigma-s 0.74 --model better --evaluator f64 --tolerance 0
x,y,z,M_1,bound,numerical_error_1,model_error_1
0,0,1,0.020916285198767114,0,6.029318663927359e-14,0.9916965035423799
0,0,0.5,0.02948449939570033,0,6.029318663927359e-14,0.9916965035423799
0,2,0,0.0095043696670954,0,6.029318663927359e-14,0.9916965035423799

$ dipole gather points.csv points.csv --sigma-a 0.032 --sigma-s 0.74
x,y,z,M_1,bound,numerical_error_1,model_error_1
0,0,0,inf,0,8.309693212513114e-5,0
1,0,0,inf,0,8.309693212513114e-5,0
! dipole gather: 2 of 2 queries are at a point, where R of transport is infinite: M is inf there; move them off the points by half the radius of a disc of a point's area

$ dipole gather points.csv queries.csv --sigma-a 0.032 --sigma-s 0.74 --model better --format json
{
  "software": "dipoled 0.1.0",
  "model": "better",
  "evaluator": "lut",
  "moments": "exact",
  "bound": 0,
  "numerical_error_1": 8.453424618249404e-5,
  "model_error_1": 0.9916965033474425,
  "notes": "",
  "units": {"x": "mm", "y": "mm", "z": "mm", "M_1": "W/mm^2"},
  "rows": [
    {"x": 0, "y": 0, "z": 1, "M_1": 0.02091629710048437},
    {"x": 0, "y": 0, "z": 0.5, "M_1": 0.02948456723242998},
    {"x": 0, "y": 2, "z": 0, "M_1": 0.009504278656095266}
  ]
}

$ printf 'x,y,z,power_1,power_2\n0,0,0,1,2\n' | dipole gather - queries.csv --sigma-a 0.032,0.1 --sigma-s 0.74 --model better --format table
model better, evaluator lut, moments exact, error by grouping 3.9e-05, numerical_error_1 8.5e-05, model_error_1 9.9e-01, numerical_error_2 8.4e-05, model_error_2 9.9e-01

 x   y    z          M_1          M_2
mm  mm   mm       W/mm^2       W/mm^2
--  --  ---  -----------  -----------
 0   0    1  1.54819e-02  2.31077e-02
 0   0  0.5  2.24799e-02  3.69470e-02
 0   2    0  6.70890e-03  8.20173e-03

$ dipole gather points.csv queries.csv --sigma-a 0.03 --sigma-s 1 --eta 5 --g 0.5 --model single --format table | head -1
model single, evaluator lut, moments exact, error by grouping 0.0e+00, numerical_error_1 8.4e-05, model_error_1 not solved

$ for text in '' 'x,y,z\n0,0,0\n' 'x,y,power\n' 'x,y,z,power\n' 'x,y,z,power\n0,0,0,1\n0,zero,0,1\n' 'x,y,z,power\n0,0,0,1\n# no\n0,1e30,0,1\n' 'x,y,z,power\n0,0,0,1\n0,0,0,-1\n' 'x,y,z,power\n0,0\n' 'x,y,z,power_1,power_2\n0,0,0,1,1\n' 'x,y,z,power_1,power_3\n0,0,0,1,1\n' 'x,y,z,power,power_1\n0,0,0,1,1\n'; do printf "$text" | dipole gather - queries.csv --sigma-a 0.032 --sigma-s 0.74; done
! dipole gather: standard input: it has no header, a line that names the columns
! dipole gather: standard input: the column power or power_1 is missing; the header has x, y, z; it needs it for each point
! dipole gather: standard input: the column z is missing; the header has x, y, power; it needs x, y and z in mm, and points power, or power_1 and so on, in W
! dipole gather: standard input: it has no points
! dipole gather: standard input: line 3: y: 'zero' is no number
! dipole gather: standard input: line 4: bad-value: points: allowed: coordinates from -1e9 to 1e9 mm
! dipole gather: standard input: line 3: bad-value: power: allowed: 0 to 1e30
! dipole gather: standard input: line 2: z: there is no number
! dipole gather: standard input: powers of each point: 2, channels of the medium: 1: give as many media as powers, or choose a channel with --channel
! `dipole gather --help` says more.
! dipole gather: standard input: the column power_3: give power alone, or power_1 and so on without a gap
! dipole gather: standard input: the column power_1: give power alone, or power_1 and so on without a gap
? 1

$ printf 'x,y,z\n0,0,0\n0,inf,0\n' | dipole gather points.csv - --sigma-a 0.032 --sigma-s 0.74
! dipole gather: standard input: line 3: bad-value: queries: allowed: coordinates from -1e9 to 1e9 mm
? 1

$ for one in 'points.csv' 'points.csv queries.csv' 'points.csv queries.csv --medium skin1' 'points.csv queries.csv --medium skin1 --channel red --tolerance much'; do dipole gather $one || echo $?; done
2
2
2
2
! dipole gather: name two files: the points, and the queries
! `dipole gather --help` says more.
! dipole gather: give --medium NAME, or --sigma-a and --sigma-s, or --layer
! `dipole gather --help` says more.
! dipole gather: points.csv: powers of each point: 1, channels of the medium: 3: give as many media as powers, or choose a channel with --channel
! `dipole gather --help` says more.
! dipole gather: --tolerance: 'much' is no decimal number
! `dipole gather --help` says more.

$ dipole gather points.csv queries.csv --medium skin1 --channel red --tolerance 0.9
! dipole gather: bad-value: tolerance: allowed: 1e-9 to 0.5; or 0: each point is summed by itself (--tolerance)
? 1

$ dipole gather none.csv queries.csv --medium skin1 --channel red
! dipole gather: none.csv: No such file or directory
? 1
