## Path lengths and modulated light: the examples of core/TISSUE.md, and what is refused.
$ dipole eval --model transport --sigma-a 0.01 --sigma-s 1 --eta 1.4 --r 10,20,30 --wanted path,dpf,time | head -n 8
moments exact, R in 1/mm^2 per unit of power that entered

    transport  transport  transport
 r     path 1      dpf 1     time 1
mm         mm          1         ps
--  ---------  ---------  ---------
10    61.9051    6.19051    289.091
20    138.805    6.94024    648.204

$ dipole eval --model transport --sigma-a 0.01 --sigma-s 1 --eta 1.4 --r 10,20,30 --mhz 100 --wanted phase,modulation | head -n 8
moments exact, mhz 100, R in 1/mm^2 per unit of power that entered

    transport     transport
 r    phase 1  modulation 1
mm    degrees             1
--  ---------  ------------
10    10.3534      0.991679
20    23.1744      0.977698

$ dipole eval --model transport --sigma-a 0.01 --sigma-s 1 --eta 1.4 --f 0,0.04 --mhz 100 --wanted phase_f,modulation_f | head -n 8
moments exact, mhz 100, R_f, the reflectance of striped light

      transport       transport
   f  phase_f 1  modulation_f 1
1/mm    degrees               1
----  ---------  --------------
   0    3.65443        0.994739
0.04    1.87091        0.999062

$ dipole eval --model transport --sigma-a 0 --sigma-s 1 --eta 1.4 --r 10 --wanted path
! dipole eval: bad-value: sigma_a: allowed: above 0 with path, dpf and time of this model: dipoles and single have a limit (--sigma-a)
? 1

$ dipole eval --model better --sigma-a 0 --sigma-s 1 --eta 1.4 --r 10 --wanted path --format csv
model,channel,sigma_a,sigma_s,g,eta,r,path,numerical_error,model_error,evaluator,notes
better,1,0,1,0,1.4,10,173.43792738162415,2.5783880258476323e-12,,f64,

$ dipole eval --model transport --sigma-a 0.01 --sigma-s 1 --eta 1.4 --r 10 --wanted phase
! dipole eval: model transport: bad-value: mhz: allowed: a frequency: phase and modulation need it (--mhz)
? 1
