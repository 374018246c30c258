## dipole sample: drawn radii.
$ dipole sample --medium skin1 --count 3 --draw stratified --model better
skin1, model better, evaluator f64, moments exact, draw stratified, seed 1, first 0

           better    better    better      better      better      better
       u    r red   r green    r blue     pdf red   pdf green    pdf blue
       1       mm        mm        mm        1/mm        1/mm        1/mm
--------  -------  --------  --------  ----------  ----------  ----------
0.188854  1.13878  0.647663  0.397439  2.4327e-01  4.5647e-01  7.6586e-01
0.581927  3.10816   1.62878  0.959942  1.4561e-01  3.0265e-01  5.4145e-01
0.990334  14.2919   6.71729    3.8004  3.0979e-03  7.1859e-03  1.2858e-02

model   channel  sigma_a  sigma_s  g  eta  numerical error  model error  evaluator  notes
                    1/mm     1/mm
------  -------  -------  -------  -  ---  ---------------  -----------  ---------  -----
better  red        0.032     0.74  0  1.3          2.4e-15      1.0e+00        f64
better  green       0.17     0.88  0  1.3          2.9e-15      1.0e+00        f64
better  blue        0.48     1.01  0  1.3          3.3e-15      1.2e+00        f64
numerical error: at most, against the model's formula
model error: the largest, of the model against radiative transport
errors are relative, but of ln R, its derivatives, paths and modulated light absolute, as the
cdf's model error is, and of R_f over the albedo
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.982987 (eta 1.3)

$ dipole sample --medium skin1 --channel red --u 0,0.25,0.5,1 --model better --format csv
model,channel,sigma_a,sigma_s,g,eta,u,r,pdf,numerical_error,model_error,evaluator,notes
better,red,0.032,0.74,0,1.3,0,0,0,2.3901722738496005e-15,0.9985358272614797,f64,
better,red,0.032,0.74,0,1.3,0.25,1.3913407102422006,0.23934811321103716,3.0494806565984246e-15,0.9985358272614797,f64,
better,red,0.032,0.74,0,1.3,0.5,2.593024470627993,0.17309117145510747,3.618917151055318e-15,0.9985358272614797,f64,
better,red,0.032,0.74,0,1.3,1,inf,0,2.3901722738496005e-15,0.9985358272614797,f64,

$ dipole sample --sigma-a 0.032 --sigma-s 0.74 --count 2 --model better --format json
{
  "software": "dipoled 0.1.0",
  "model": "better",
  "evaluator": "f64",
  "moments": "exact",
  "draw": "random",
  "seed": 1,
  "first": 0,
  "units": {"sigma_a": "1/mm", "sigma_s": "1/mm", "u": "1", "r": "mm", "pdf": "1/mm"},
  "rows": [
    {"model": "better", "channel": "1", "sigma_a": 0.032, "sigma_s": 0.74, "g": 0, "eta": 1.3, "u": 0.5665615751722809, "r": 3.00448705649246, "pdf": 0.15083573061717723, "numerical_error": 3.813895081371701e-15, "model_error": 0.9985358272614797, "evaluator": "f64", "notes": ""},
    {"model": "better", "channel": "1", "sigma_a": 0.032, "sigma_s": 0.74, "g": 0, "eta": 1.3, "u": 0.7457817572627011, "r": 4.53377092507696, "pdf": 0.08866992108543609, "numerical_error": 4.538569969943599e-15, "model_error": 0.9985358272614797, "evaluator": "f64", "notes": ""}
  ]
}

$ dipole sample --sigma-a 0.032 --sigma-s 0.74 --count 2 --seed 7 --first 3 --wanted r,pdf,cdf,albedo --format csv
model,channel,sigma_a,sigma_s,g,eta,u,albedo,cdf,r,pdf,numerical_error,model_error,numerical_error_albedo,model_error_albedo,numerical_error_cdf,model_error_cdf,numerical_error_pdf,model_error_pdf,evaluator,notes
transport,1,0.032,0.74,0,1.3,0.58293027,0.43945764501319085,0.5829253,2.4647195,0.13625905,8.30018799703575e-5,0,8.30018799703575e-5,0,8.30018799703575e-5,0,8.30018799703575e-5,0,lut,
transport,1,0.032,0.74,0,1.3,0.45244187,0.43945764501319085,0.452437,1.6285086,0.17802525,8.30018799703575e-5,0,8.30018799703575e-5,0,8.30018799703575e-5,0,8.30018799703575e-5,0,lut,

$ for one in '' '--medium skin1 --u 0.5 --count 3' '--medium skin1 --u half' '--medium skin1 --count -1' '--medium skin1 --draw lots' '--medium skin1 --draw list'; do dipole sample $one || echo $?; done
2
2
2
2
2
2
! dipole sample: give --medium NAME, or --sigma-a and --sigma-s, or --layer
! `dipole sample --help` says more.
! dipole sample: --u gives the numbers one by one: leave --count, --draw, --seed and --first out
! `dipole sample --help` says more.
! dipole sample: --u: 'half' is no decimal number
! `dipole sample --help` says more.
! dipole sample: --count: '-1' is no whole number
! `dipole sample --help` says more.
! dipole sample: --draw: 'lots' is unknown; this daemon has list, regular, stratified, random
! `dipole sample --help` says more.
! dipole sample: --draw list: give the numbers with --u
! `dipole sample --help` says more.

$ dipole sample --medium skin1 --u 0.5,1.5
! dipole sample: bad-value: u number 2 of 2: allowed: 0 to 1, both included (--u)
? 1

$ dipole sample --medium skin1 --count 0
! dipole sample: bad-count: sample_count: allowed: 1 to 2^52 (--count)
? 1

$ dipole sample --medium skin1 --draw regular --seed 3
! dipole sample: bad-value: seed: allowed: 0 unless the draw is random or stratified (--seed)
? 1

$ dipole sample --medium skin1 --draw regular --first 3
! dipole sample: bad-value: sample_first: allowed: 0 unless the draw is random (--first)
? 1

$ dipole sample --medium skin1 --model gaussians
! dipole sample: bad-value: model: allowed: a model that covers all radii (--model)
? 1

## Options reach the requests of all commands.
$ printf 'sample,r,R,error\na,.5,.02,.0004\na,1,.006,.0001\na,2,.001,.00002\n' > a.csv; printf 'x,y,z,power\n0,0,0,1\n' > p.csv; printf 'Pf\n1 1\n-1.0\n\0\0\0\077' > i.pfm

$ M='--sigma-a .03 --sigma-s 1'; for one in "eval $M" "sample $M" "table $M --output x" 'invert --albedo .4 --mean-free-path 1' 'texture i.pfm o.pfm --mean-free-path 1' "gather p.csv p.csv $M" 'fit a.csv'; do dipole $one --model better --eta 3 --moments fit; done; for one in "sample $M" "table $M --output x" "bench --seconds .01 $M" 'texture i.pfm o.pfm --mean-free-path 1' 'fit a.csv --eta 1.4'; do dipole $one --model better --surface-albedo .5; done
! dipole eval: bad-value: eta: allowed: 0.195 to 2.485 with moments fit (--eta)
! dipole sample: bad-value: eta: allowed: 0.195 to 2.485 with moments fit (--eta)
! dipole table: bad-value: eta: allowed: 0.195 to 2.485 with moments fit (--eta)
! dipole invert: bad-value: eta: allowed: 0.195 to 2.485 with moments fit (--eta)
! dipole texture: bad-value: eta of medium 1 of 3: allowed: 0.195 to 2.485 with moments fit (--eta)
! dipole gather: bad-value: eta: allowed: 0.195 to 2.485 with moments fit (--eta)
! dipole fit: bad-value: eta of medium 1 of 3: allowed: 0.195 to 2.485 with moments fit (--eta)
! dipole sample: bad-value: surface_albedo: allowed: nothing: this model does not take it (--surface-albedo)
! dipole table: bad-value: surface_albedo: allowed: nothing: this model does not take it (--surface-albedo)
! dipole bench: bad-value: surface_albedo: allowed: nothing: this model does not take it (--surface-albedo)
! dipole texture: bad-value: surface_albedo: allowed: nothing: this model does not take it (--surface-albedo)
! dipole fit: bad-value: surface_albedo: allowed: nothing: this model does not take it (--surface-albedo)
? 1

$ M='--sigma-a .03 --sigma-s 1'; for one in "sample $M --count 65536" 'texture i.pfm o.pfm --mean-free-path 1' "gather p.csv p.csv $M" 'fit a.csv'; do n=$((n + 1)); dipole $one --g .871 --eta 1.37$n --deadline-ms 1; done
! dipole sample: deadline: the reply would come later than the deadline: deadline_ms: allowed: more milliseconds, or 0 for no limit (--deadline-ms)
! dipole texture: deadline: the reply would come later than the deadline: deadline_ms: allowed: more milliseconds, or 0 for no limit (--deadline-ms)
! dipole gather: ...deadline_ms... (--deadline-ms)
! dipole fit: deadline: the reply would come later than the deadline: deadline_ms: allowed: more milliseconds, or 0 for no limit (--deadline-ms)
? 1

$ for one in --mean --diffuse-mean '--extinction --g .5' '--mean --g .5' '--mean --light diffuse' '--mean --light diffuse --specular' '--mean --gamma .6 --g .5' '--mean --moments fit --model better --eta 2' '--mean --unit 2'; do dipole texture i.pfm o.pfm --coefficients sigma_a $(echo $one | sed 's/mean/&-free-path 1/; s/extinction/&-path 1/'); od -An -tf4 -j 12 o.pfm; done
     0.028738452
      0.09927127
     0.014202105
     0.028006459
     0.032078914
     0.039067037
     0.032223113
    0.0048104483
     0.014369226
