## dipole eval --table: files that are no intact tables.
$ dipole table --sigma-a 0.032 --sigma-s 0.74 --output a > /dev/null; dipole table --model burley --sigma-a 0.032 --sigma-s 0.74 --output b > /dev/null; head -c -8 a > cut; (head -c -1 a; printf x) > damaged; (head -c 24 a; printf '\001'; tail -c +26 a) > old; cat a damaged > second; (cat a; echo) > longer; seq 999 > text; : > empty; cat a b > both

$ for one in empty text cut damaged second longer old both missing; do dipole eval --table $one --r 1 || echo $?; done
1
1
1
1
1
1
1
1
1
! dipole eval: empty: table 1: this is not an intact table: it is too short
! dipole eval: text: table 1: this is not an intact table: it does not start as one
! dipole eval: cut: table 1: this is not an intact table: its end is missing
! dipole eval: damaged: table 1: this is not an intact table: its counts or its checksum are wrong
! dipole eval: second: table 2: this is not an intact table: its counts or its checksum are wrong
! dipole eval: longer: table 2: this is not an intact table: it is too short
! dipole eval: old: table 1: this table has layout 1, but this library reads layout 5: fetch the table again, from a daemon of this library's version
! dipole eval: both: tables 1 and 2 differ in model, moments, parameters or number of layers: put them into separate files
! dipole eval: cannot read missing: No such file or directory

$ DIPOLED=unix:/nonexistent dipole eval --table - --r 1 < a
moments exact, R in 1/mm^2 per unit of power that entered

      transport
 r  R skin1 red
mm       1/mm^2
--  -----------
 1   1.5701e-02

model      channel    sigma_a  sigma_s  g  eta    albedo  numerical error  model error  evaluator  notes
                         1/mm     1/mm                 1
---------  ---------  -------  -------  -  ---  --------  ---------------  -----------  ---------  -----
transport  skin1 red    0.032     0.74  0  1.3  0.439458          8.3e-05      0.0e+00        lut
numerical error: at most, against the model's formula, at r = 1 mm
model error: the largest, of the model against radiative transport
errors are relative, but of ln R, its derivatives, paths and modulated light absolute, as the
cdf's model error is, and of R_f over the albedo
per unit of power launched: values times 1 - ((eta - 1) / (eta + 1))^2 = 0.982987 (eta 1.3)

$ dipole eval --table a --plot a.svg > /dev/null; head -c 5 a.svg; echo
<?xml
