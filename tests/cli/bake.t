## dipole bake: kernels and lengths of a medium for engines. The error stands in each file.
$ dipole bake kernel --medium skin1 --eta 1.4 --common --format hlsl --taps 11
// kernel by transport, dipoled 0.1.0
// sigma_a 0.032 0.17 0.48 (absorption coefficient, 1/mm)
// sigma_s 0.74 0.88 1.01 (scattering coefficient, 1/mm)
// g 0 0 0 (mean cosine of the scattering angle)
// eta 1.4 1.4 1.4 (refractive index)
// colour 0.400296 0.186303 0.0988927 (share that leaves of the light that entered at normal incidence)
// transport_error 3.21e-06 3.21e-06 3.21e-06 (relative error of R and of the cdf; the other errors are beside it)
// range_mm 7.3783 7.3783 7.3783 (offset of the last tap)
// edge_error 0.0135512 0.0275542 0.0501109 (largest error beside a straight shadow edge, of the light inside, if taps take the light of their bins (half the way to each neighbour))
// step 0.158057 0.30317 0.479536 (largest step if an edge is sharper than the taps lie apart)
// beyond 0.0242815 0.000527959 0 (share of the light beyond the taps' bins, which the last taps take)
// columns: weight_red,weight_green,weight_blue,offset
static const float4 baked[11] = {
  float4(0.032196861, 0.00207500759, 3.58007148e-05, -7.37830464),
  float4(0.0481108493, 0.011315975, 0.000968839897, -4.72211497),
  float4(0.0871605803, 0.0442849036, 0.0112607738, -2.65618967),
  float4(0.123239642, 0.110864044, 0.063187561, -1.18052874),
  float4(0.13026341, 0.179875251, 0.184779152, -0.295132185),
  float4(0.158057314, 0.303169639, 0.479535745, 0),
  float4(0.13026341, 0.179875251, 0.184779152, 0.295132185),
  float4(0.123239642, 0.110864044, 0.063187561, 1.18052874),
  float4(0.0871605803, 0.0442849036, 0.0112607738, 2.65618967),
  float4(0.0481108493, 0.011315975, 0.000968839897, 4.72211497),
  float4(0.032196861, 0.00207500759, 3.58007148e-05, 7.37830464),
};

$ dipole bake kernel --sigma-a .1 --sigma-s 1 --g 0 --taps 11 --range 4
// kernel by transport, dipoled 0.1.0
// sigma_a 0.1 0.1 0.1 (absorption coefficient, 1/mm)
// sigma_s 1 1 1 (scattering coefficient, 1/mm)
// g 0 0 0 (mean cosine of the scattering angle)
// eta 1.3 1.3 1.3 (refractive index)
// colour 0.306607 0.306607 0.306607 (share that leaves of the light that entered at normal incidence)
// transport_error 3.21e-06 3.21e-06 3.21e-06 (relative error of R and of the cdf; the other errors are beside it)
// range_mm 4 4 4 (offset of the last tap)
// edge_error 0.015625 0.015625 0.015625 (largest error beside a straight shadow edge, of the light inside, if taps take the light of their bins (half the way to each neighbour))
// step 0.172227 0.172227 0.172227 (largest step if an edge is sharper than the taps lie apart)
// beyond 0.0203938 0.0203938 0.0203938 (share of the light beyond the taps' bins, which the last taps take)
// columns: weight_red,weight_green,weight_blue,offset_red,offset_green,offset_blue
static const float baked[11][6] = {
  {0.028129308, 0.028129308, 0.028129308, -4, -4, -4},
  {0.0438854129, 0.0438854129, 0.0438854129, -2.56, -2.56, -2.56},
  {0.0811785422, 0.0811785422, 0.0811785422, -1.44, -1.44, -1.44},
  {0.121400694, 0.121400694, 0.121400694, -0.64, -0.64, -0.64},
  {0.13929262, 0.13929262, 0.13929262, -0.16, -0.16, -0.16},
  {0.172226846, 0.172226846, 0.172226846, 0, 0, 0},
  {0.13929262, 0.13929262, 0.13929262, 0.16, 0.16, 0.16},
  {0.121400694, 0.121400694, 0.121400694, 0.64, 0.64, 0.64},
  {0.0811785422, 0.0811785422, 0.0811785422, 1.44, 1.44, 1.44},
  {0.0438854129, 0.0438854129, 0.0438854129, 2.56, 2.56, 2.56},
  {0.028129308, 0.028129308, 0.028129308, 4, 4, 4},
};

$ dipole bake burley --medium skin1 --eta 1.4 --format json
{"kind": "burley", "software": "dipoled 0.1.0",
 "sigma_a": [0.032, 0.17, 0.48],
 "sigma_s": [0.74, 0.88, 1.01],
 "g": [0, 0, 0],
 "eta": [1.4, 1.4, 1.4],
 "colour": [0.400295964, 0.186303119, 0.0988926809],
 "transport_error": [3.21e-06, 3.21e-06, 3.21e-06],
 "edge_error": [0.00647387828, 0.0102949699, 0.0124814135],
 "columns": ["d_red", "d_green", "d_blue"],
 "rows": [
  [1.22272644, 0.466210495, 0.207102808]
 ]}

$ dipole bake burley --medium skin1 --eta 1.4 --format csv
# burley by transport, dipoled 0.1.0
# sigma_a 0.032 0.17 0.48 (absorption coefficient, 1/mm)
# sigma_s 0.74 0.88 1.01 (scattering coefficient, 1/mm)
# g 0 0 0 (mean cosine of the scattering angle)
# eta 1.4 1.4 1.4 (refractive index)
# colour 0.400296 0.186303 0.0988927 (share that leaves of the light that entered at normal incidence)
# transport_error 3.21e-06 3.21e-06 3.21e-06 (relative error of R and of the cdf; the other errors are beside it)
# edge_error 0.00647388 0.010295 0.0124814 (largest error beside a straight shadow edge, of the light inside)
d_red,d_green,d_blue
1.22272644,0.466210495,0.207102808

$ dipole bake colour-map --size 16 --format cube --eta 1.5
# colour-map by transport, dipoled 0.1.0
# g 0 (mean cosine of the scattering angle)
# eta 1.5 (refractive index)
# colour_error 0.0174603 (largest error of the colour that a walk shows, from the second colour on)
LUT_1D_SIZE 16
0 0 0
0.607170902 0.607170902 0.607170902
0.792875794 0.792875794 0.792875794
0.877038021 0.877038021 0.877038021
0.922512493 0.922512493 0.922512493
0.949630559 0.949630559 0.949630559
0.966817309 0.966817309 0.966817309
0.978138679 0.978138679 0.978138679
0.985772321 0.985772321 0.985772321
0.990976657 0.990976657 0.990976657
0.99452226 0.99452226 0.99452226
0.996903004 0.996903004 0.996903004
0.998447291 0.998447291 0.998447291
0.999380194 0.999380194 0.999380194
0.999859902 0.999859902 0.999859902
1 1 1

$ dipole bake colour-map --size 16 --format spi1d --eta 1.5 --light furnace
! dipole bake: --light: 'furnace' is unknown; this daemon has beam, diffuse
! `dipole bake --help` says more.
? 2

$ for one in kernel 'halo --medium skin1' 'kernel --medium skin1 --taps 12' 'gaussians --medium skin1 --count 13' 'kernel --medium skin1 --range 0' 'colour-map --size 2' 'lut --medium skin1 --size 129' 'profile --medium skin1 --range 1,2,3' 'formula --eta 1.9' 'colour-map --medium skin1' 'kernel --medium skin1 --size 32' 'burley --medium skin1 --light diffuse' 'colour-map --eta 1.4,1.5'; do dipole bake $one || echo $?; done
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
2
2
2
! dipole bake: give --medium NAME, or --sigma-a and --sigma-s, or --layer
! `dipole bake --help` says more.
! dipole bake: give a KIND: kernel, burley, gaussians, lut, profile, colour-map or formula
! `dipole bake --help` says more.
! dipole bake: --taps: an odd number from 11 to 33
! `dipole bake --help` says more.
! dipole bake: --count: 2 to 12
! `dipole bake --help` says more.
! dipole bake: --range: more than 0, up to 1e+06 mm
! `dipole bake --help` says more.
! dipole bake: --size: of colour-map, 16 to 4096
! `dipole bake --help` says more.
! dipole bake: --size: of lut, 16 to 128
! `dipole bake --help` says more.
! dipole bake: --range: one for all channels, or of kernel one for each of three
! `dipole bake --help` says more.
! dipole bake: --eta: formula takes no such option: leave it out
! `dipole bake --help` says more.
! dipole bake: --medium: colour-map takes no such option: leave it out
! `dipole bake --help` says more.
! dipole bake: --size: kernel takes no such option: leave it out
! `dipole bake --help` says more.
! dipole bake: --light: burley takes no such option: leave it out
! `dipole bake --help` says more.
! dipole bake: --g, --eta: of colour-map, one number
! `dipole bake --help` says more.

$ for one in 'kernel --medium skin1 --format cube' 'formula --format cube' 'lut --medium skin1 --format osl' 'burley --medium skin1 --format pfm'; do dipole bake $one || echo $?; done
2
2
2
2
! dipole bake: --format cube: kernel has c,hlsl,csv,json
! `dipole bake --help` says more.
! dipole bake: --format cube: formula has c,glsl,hlsl,osl,python
! `dipole bake --help` says more.
! dipole bake: --format osl: lut has c,csv,json,pfm,png
! `dipole bake --help` says more.
! dipole bake: --format pfm: burley has c,csv,json
! `dipole bake --help` says more.

$ dipole bake burley --sigma-a 1 --sigma-s 0
! dipole bake: channel 1: it does not scatter: no light leaves beside where it entered
? 1

$ for one in 'formula --light lamp' 'kernel --medium skin1 --channel red,green'; do dipole bake $one || echo $?; done
2
2
! dipole bake: --light: beam or diffuse
! `dipole bake --help` says more.
! dipole bake: give one channel or three: red, green and blue
! `dipole bake --help` says more.

## Skin: within .0065, of ranges near 10.7, 4.5 and 2.25 mm; with a range in common blue is the worse for it.
$ dipole bake kernel --medium skin1 --eta 1.4 --format json | grep -E 'edge_error|range_mm'
 "range_mm": [10.6699548, 4.51077447, 2.2535612],
 "edge_error": [0.00471135698, 0.00547616896, 0.00618965903],

$ dipole bake kernel --medium skin1 --common --format json | grep -E 'edge_error|range_mm|columns'
 "range_mm": [10.5129007, 10.5129007, 10.5129007],
 "edge_error": [0.00471818948, 0.0107206753, 0.0201279246],
 "columns": ["weight_red", "weight_green", "weight_blue", "offset"],

## Headers of all kinds compile, side by side.
$ for kind in kernel burley gaussians lut profile colour-map; do [ $kind = colour-map ] && of= || of='--medium skin1'; dipole bake $kind $of > $kind.h || echo $?; name=$(echo $kind | tr -d -); echo "#define baked $name"; echo "#include \"$kind.h\""; echo '#undef baked'; shown="$shown, (double)$name[0][0]"; done > use.c; (echo '#include <stdio.h>'; echo "int main(void) { printf(\"%g %g %g %g %g %g\"$shown); }") >> use.c; gcc -std=c99 -Wall -Wextra -Werror -o use use.c && ./use
0.0075909 1.16003 0.016452 -0.984375 0.000994414 0

## The formula is the same in all languages.
$ dipole bake formula > formula.c; for kind in glsl hlsl osl python; do dipole bake formula --format $kind > formula.$kind; done; sed '/#include/,+1d; s/^static //; s/const //g; s/sqrtf/sqrt/g; s/\([0-9]\)f/\1/g' formula.c | diff - formula.glsl; cmp formula.glsl formula.hlsl; cmp formula.glsl formula.osl; echo 'print(f"{scattered(.4, .3, 1.5):.6g}")' | cat formula.python - | /usr/bin/python3; (echo '#include <stdio.h>'; echo 'int main(void) { printf("%.6g", (double)scattered(.4f, .3f, 1.5f)); }') >> formula.c; gcc -Wall -Wextra -Werror -o formula formula.c -lm && ./formula
0.976928
0.976928

## Shaders compile.
$ (echo '#version 450'; cat formula.glsl; echo 'layout(location=0) in vec3 x;'; echo 'layout(location=0) out vec4 y;'; echo 'void main() { y = vec4(scattered(x.x, x.y, x.z)); }') > formula.frag; glslangValidator formula.frag; (dipole bake kernel --medium skin1 --common --format hlsl; echo 'float4 main(uint i : I) : SV_Target { return baked[i]; }') > taps.frag; glslangValidator -D -V -e main taps.frag
taps.frag

## Layers of one medium are that medium, within .002 of each number; the thicknesses stand there.
$ for one in burley 'kernel --range 3 --taps 11' 'profile --range 5 --size 16'; do dipole bake $one --sigma-a .1 --sigma-s 1 --format csv > whole; dipole bake $one --layer .1,1,0,1.3,1 --layer .1,1,0,1.3 --format csv > stack; grep -hE '^# (colour|thickness|transport_error)' whole stack | cut -d'(' -f1; for file in whole stack; do grep '^[-0-9]' $file > $file.rows; done; paste -d, whole.rows stack.rows | awk -F, '{ for (i = 1; i <= NF / 2; i++) { off = $(i + NF / 2) - $i; if (off * off > (.002 * $i) ^ 2) print i, $0 } } END { print NR " rows of " NF / 2 }'; done
# colour 0.306607 0.306607 0.306607 
# transport_error 3.21e-06 3.21e-06 3.21e-06 
# thickness_1 1 1 1 
# thickness_2 0 0 0 
# colour 0.306607 0.306607 0.306607 
# transport_error 0.0024053 0.0024053 0.0024053 
1 rows of 3
# colour 0.306607 0.306607 0.306607 
# transport_error 3.21e-06 3.21e-06 3.21e-06 
# thickness_1 1 1 1 
# thickness_2 0 0 0 
# colour 0.306607 0.306607 0.306607 
# transport_error 0.0024053 0.0024053 0.0024053 
11 rows of 6
# colour 0.306607 0.306607 0.306607 
# transport_error 3.21e-06 3.21e-06 3.21e-06 
# thickness_1 1 1 1 
# thickness_2 0 0 0 
# colour 0.306607 0.306607 0.306607 
# transport_error 0.0024053 0.0024053 0.0024053 
16 rows of 7

## core/COLOURS.md has the constants of the formula, which core/tools/colours.py makes from the same list.
$ grep -E '^(beam|diffuse), ' $REPOSITORY/core/COLOURS.md > rows; cut -d'|' -f1 rows | uniq -c; number='[-]?[0-9]+[.][0-9]{5}'; sed '/[|][bc][|]/s/^[^|]*//' rows | grep -oE "$number" > told; grep -oE "$number" $REPOSITORY/clients/cli/formula.def | cmp - told; wc -l < told
      3 beam, 0.00112
      3 diffuse, 0.00096
38
