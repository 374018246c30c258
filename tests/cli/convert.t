## dipole convert: what renderers mean by a colour and a length. skin_vi, marble and milk are OpenPBR's examples.
$ dipole convert --from openpbr --colour .073,.052,.025 --length 1 --eta 1.4 --to openpbr --typed
from openpbr, to openpbr, as in OpenPBR Surface 1.1, its definition of the colour, note renderers that use its example formula need --typed

channel     colour  length   sigma_a   sigma_s  g  eta  scattered  shows    as given
                                1/mm      1/mm
-------  ---------  ------  --------  --------  -  ---  ---------  -----  ----------
      1   0.187174       1    0.4103    0.5897  0  1.4     0.5897  0.073   0.0251476
      2   0.140346       1  0.509831  0.490169  0  1.4   0.490169  0.052    0.017516
      3  0.0726024       1  0.701135  0.298865  0  1.4   0.298865  0.025  0.00818372
! dipole convert: --from openpbr: renderers that use its example formula need --typed

$ dipole convert --from openpbr --colour .813,.793,.759 --length 1 --eta 1.5 --to materialx
from openpbr, to materialx, as in MaterialX 1.39, subsurface_bsdf

channel    colour  length     sigma_a   sigma_s  g  eta  scattered  shows  as given
                                 1/mm      1/mm
-------  --------  ------  ----------  --------  -  ---  ---------  -----  --------
      1  0.919459       1  0.00132853  0.998671  0  1.5   0.998671  0.813  0.615022
      2  0.909839       1  0.00168288  0.998317  0  1.5   0.998317  0.793  0.582999
      3  0.892964       1  0.00241753  0.997582  0  1.5   0.997582  0.759  0.531815
! dipole convert: --from openpbr: renderers that use its example formula need --typed
! dipole convert: materialx cannot say the index, 1.5

$ dipole convert --from openpbr --colour .808 --length 1 --eta 1.35 --to cycles
from openpbr, to cycles, as in Blender 4, Principled BSDF, Random Walk, note its walk lets light out without refraction: colours to type make up for it at normal incidence, and come out up to .05 brighter in a dome

channel    colour  length     sigma_a   sigma_s  g   eta  scattered  shows  as given
                                 1/mm      1/mm
-------  --------  ------  ----------  --------  -  ----  ---------  -----  --------
      1  0.842151       1  0.00212696  0.997873  0  1.35   0.997873  0.808  0.768233
! dipole convert: --from openpbr: renderers that use its example formula need --typed

## Jensen's table of RenderMan: skin1
$ dipole convert --from coefficients --medium skin1 --to pxr
from coefficients, to pxr, as in RenderMan PxrSurface, Jensen's table of Subsurface Scattering Parameters, note not settled for its other models: their formulas are not published

channel    colour    length  sigma_a  sigma_s  g  eta  scattered     shows  as given
                                1/mm     1/mm
-------  --------  --------  -------  -------  -  ---  ---------  --------  --------
      1  0.436049   3.67329    0.032     0.74  0  1.3   0.958549  0.439458         -
      2  0.227366   1.36653     0.17     0.88  0  1.3   0.838095  0.213259         -
      3   0.13101  0.682693     0.48     1.01  0  1.3   0.677852  0.115435         -

$ dipole convert --from pxr --colour .436,.227,.131 --length 3.67,1.37,.68 --eta 1.3
from pxr, to coefficients

channel    sigma_a   sigma_s  g  eta  scattered     shows  as given
              1/mm      1/mm
-------  ---------  --------  -  ---  ---------  --------  --------
      1  0.0320337  0.740538  0  1.3   0.958536  0.439405         -
      2   0.169783  0.876247  0  1.3   0.837688  0.212871         -
      3   0.481919   1.01393  0  1.3   0.677829  0.115426         -
! dipole convert: --from pxr: not settled for its other models: their formulas are not published

## skin1 for engines
$ dipole convert --from coefficients --medium skin1 --eta 1.4 --to unity --format native
_BaseColor: {r: 0.400295964, g: 0.186303119, b: 0.0988926809, a: 1}
scatteringDistance: {r: 1, g: 0.381287654, b: 0.169377877, a: 1}
scatteringDistanceMultiplier: 1.22272644
ior: 1.4
! dipole convert: unity has Burley's profile alone: the length is that whose shadow edge is the nearest

$ dipole convert --from coefficients --medium skin1 --eta 1.4 --to unreal --format native
# profile: an unreal.SubsurfaceProfileStruct
profile.set_editor_property("surface_albedo", unreal.LinearColor(0.400295964, 0.186303119, 0.0988926809, 1))
profile.set_editor_property("mean_free_path_color", unreal.LinearColor(1, 0.659691614, 0.371805915, 1))
profile.set_editor_property("mean_free_path_distance", 0.139149472)
profile.set_editor_property("ior", 1.4)
! dipole convert: unreal has Burley's profile alone: the length is that whose shadow edge is the nearest

$ dipole convert --from coefficients --medium skin1 --eta 1.4 --to blender-burley --format native
# bsdf: the node Principled BSDF
bsdf.inputs["Subsurface Weight"].default_value = 1
bsdf.inputs["Base Color"].default_value[:3] = (0.400295964, 0.186303119, 0.0988926809)
bsdf.inputs["Subsurface Radius"].default_value[:3] = (1, 0.381287654, 0.169377877)
bsdf.inputs["Subsurface Scale"].default_value = 15.3652336
! dipole convert: blender-burley cannot say the index, 1.4
! dipole convert: blender-burley has Burley's profile alone: the length is that whose shadow edge is the nearest

$ dipole convert --from coefficients --medium skin1 --eta 1.4 --to openpbr --typed --format native
<?xml version="1.0"?>
<materialx version="1.39">
  <open_pbr_surface name="subsurface" type="surfaceshader">
    <input name="subsurface_weight" type="float" value="1" />
    <input name="subsurface_color" type="color3" value="0.624990941, 0.383607236, 0.239355613" />
    <input name="subsurface_radius_scale" type="color3" value="1, 0.735238095, 0.518120805" />
    <input name="subsurface_radius" type="float" value="1.29533679" />
    <input name="subsurface_scatter_anisotropy" type="float" value="0" />
    <input name="specular_ior" type="float" value="1.4" />
  </open_pbr_surface>
</materialx>

$ dipole convert --from coefficients --medium skin1 --eta 1.4 --to gltf --format native
{"extensions": {
  "KHR_materials_scatter": {"multiscatterColorFactor": [0.624990941, 0.383607236, 0.239355613], "scatterAnisotropy": 0, "scatterStrengthFactor": 1},
  "KHR_materials_volume": {"attenuationDistance": 0.00129533679, "attenuationColor": [0.367879441, 0.256634181, 0.145140678]},
  "KHR_materials_ior": {"ior": 1.4}}}

$ dipole convert --from openpbr --colour .8,.5,.2 --srgb --length 1,.5,.25 --unit cm --g .8 --eta 1.4 --to pbrt --format native
Material "subsurface" "rgb reflectance" [ 0.603827339 0.21404114 0.0331047666 ] "rgb mfp" [ 10 5 2.5 ] "float g" [ 0.8 ] "float eta" [ 1.4 ]
! dipole convert: --from openpbr: renderers that use its example formula need --typed

$ for one in '--colour .5 --length 1' '--from openpbr --colour .5' '--from openpbr --colour 1.5 --length 1' '--from openpbr --colour .5 --length 1 --g -.1 --to appleseed-glass' '--from openbr --colour .5 --length 1' '--from openpbr --colour .5 --length 1 --sigma-a 1' '--from openpbr --colour .5 --length 1 --unit inch' '--from openpbr --colour .5 --length 1 --to gltf --format native'; do dipole convert $one || echo $?; done
2
2
2
2
2
2
2
2
! dipole convert: give --from: a convention, or coefficients
! `dipole convert --help` says more.
! dipole convert: give --colour, and --length for all or each of its channels
! `dipole convert --help` says more.
! dipole convert: --colour: 1.5 is not from 0 to 1: divide values of 8 bits by 255
! `dipole convert --help` says more.
! dipole convert: --g: the formula of appleseed-glass is for g from 0 on
! `dipole convert --help` says more.
! dipole convert: --from: 'openbr' is unknown; there are coefficients, openpbr, materialx, standard-surface, cycles, blender-skin, blender-burley, gltf, gltf-volume-scatter, dspbr, pxr, pbrt, appleseed-diffuse, appleseed-glass, unreal, unity
! `dipole convert --help` says more.
! dipole convert: --medium, --sigma-a, --sigma-s: these are of --from coefficients
! `dipole convert --help` says more.
! dipole convert: --unit: mm, cm, m, or a number of millimetres
! `dipole convert --help` says more.
! dipole convert: --format native: give three channels, not 1
! `dipole convert --help` says more.

$ dipole convert --from dspbr --colour .5,.0003 --length 1 --g .9
! dipole convert: --colour: channel 2 is too dark for its g; allowed is sigma_a 0 to 1000 sigma_s (1 - g) with transport
? 1

$ dipole convert --from openpbr --colour .00001 --length 1
! dipole convert: --colour: channel 1: no medium has the colour 1e-05 and the length
? 1

$ echo '{}' > x; dipole convert --from coefficients --medium skin1 --thickness 2 --to openpbr || echo $?; dipole convert --from unity x || echo $?
2
1
! dipole convert: --thickness: no such option
! `dipole convert --help` says more.
! dipole convert: x: files are read --from openpbr, materialx, standard-surface, gltf, gltf-volume-scatter and pbrt
! `dipole convert --help` says more.

$ for one in '--to dspbr --format native' '--length inf' '--length 1,0'; do dipole convert --from openpbr --colour .5,.4 --length 1,1 $one || echo $?; done; dipole convert --from openpbr --colour .5,.4,.3 --length 1 --g .1,.2 || echo $?; dipole convert --from coefficients --medium skin-dark || echo $?
2
2
2
2
2
! dipole convert: --format native: dspbr has none; take json or csv
! `dipole convert --help` says more.
! dipole convert: --length: inf is not more than 0 and finite
! `dipole convert --help` says more.
! dipole convert: --length: 0 is not more than 0 and finite
! `dipole convert --help` says more.
! dipole convert: --g, --eta: one for all channels, or one for each
! `dipole convert --help` says more.
! dipole convert: --medium skin-dark has layers: this command takes half spaces
! `dipole convert --help` says more.

$ printf '<materialx><standard_surface/></materialx>' > x.mtlx; dipole convert --from openpbr x.mtlx || echo $?; printf 'Material "diffuse"' > x.pbrt; dipole convert --from pbrt x.pbrt; printf '\0' > x; dipole convert --from gltf x
1
! dipole convert: x.mtlx: it has no element open_pbr_surface, which this --from reads
! dipole convert: x.pbrt: it has no material "subsurface"
! dipole convert: x: it is larger than 16 MiB, or no text
? 1

$ dipole convert --from gltf --colour .5 --length 1 --unit mm
! dipole convert: --unit: the lengths of gltf and coefficients have units of their own: leave it out
! `dipole convert --help` says more.
? 2

$ dipole convert --from openpbr --colour .5,.4,.3 --length 1 --g 0,.1,.2 --to gltf --format native
! dipole convert: --format native: one g and eta for all channels
! `dipole convert --help` says more.
? 2

## Colours to type for an index of 1.5: by van de Hulst's formula .270, .438, .561, .657, .736, .804, .862, .913, .959. A walk in such a medium shows what was wanted.
$ dipole convert --from openpbr --colour .1,.2,.3,.4,.5,.6,.7,.8,.9 --length 1 --to openpbr --typed 2>&1
dipole convert: --from openpbr: renderers that use its example formula need --typed
from openpbr, to openpbr, as in OpenPBR Surface 1.1, its definition of the colour, note renderers that use its example formula need --typed

channel    colour  length      sigma_a   sigma_s  g  eta  scattered  shows   as given
                                  1/mm      1/mm
-------  --------  ------  -----------  --------  -  ---  ---------  -----  ---------
      1  0.269924       1     0.279339  0.720661  0  1.5   0.720661    0.1  0.0302757
      2  0.437994       1     0.122962  0.877038  0  1.5   0.877038    0.2  0.0681066
      3  0.560613       1    0.0623104   0.93769  0  1.5    0.93769    0.3   0.115302
      4  0.657087       1    0.0331827  0.966817  0  1.5   0.966817    0.4   0.174077
      5  0.736459       1    0.0176771  0.982323  0  1.5   0.982323    0.5   0.247215
      6  0.803733       1   0.00902334  0.990977  0  1.5   0.990977    0.6   0.338269
      7  0.861981       1   0.00416527  0.995835  0  1.5   0.995835    0.7   0.451851
      8  0.913231       1   0.00155271  0.998447  0  1.5   0.998447    0.8    0.59404
      9  0.958897       1  0.000331252  0.999669  0  1.5   0.999669    0.9   0.773011

$ dipole convert --from materialx --eta 1.5 --length 1 --colour "$(dipole convert --from openpbr --colour .1,.2,.3,.4,.5,.6,.7,.8,.9 --length 1 --to openpbr --typed --format csv 2>/dev/null | cut -d, -f2 | tail -n +2 | paste -sd,)"
from materialx, to coefficients

channel      sigma_a   sigma_s  g  eta  scattered  shows  as given
                1/mm      1/mm
-------  -----------  --------  -  ---  ---------  -----  --------
      1     0.279339  0.720661  0  1.5   0.720661    0.1         -
      2     0.122962  0.877038  0  1.5   0.877038    0.2         -
      3    0.0623104   0.93769  0  1.5    0.93769    0.3         -
      4    0.0331827  0.966817  0  1.5   0.966817    0.4         -
      5    0.0176771  0.982323  0  1.5   0.982323    0.5         -
      6   0.00902334  0.990977  0  1.5   0.990977    0.6         -
      7   0.00416527  0.995835  0  1.5   0.995835    0.7         -
      8   0.00155271  0.998447  0  1.5   0.998447    0.8         -
      9  0.000331252  0.999669  0  1.5   0.999669    0.9         -

## Blender 4's walk without an interface: the medium of its typed colours shows the wanted ones with the index 1.
$ dipole convert --from materialx --eta 1 --length 1 --g .5 --colour "$(dipole convert --from openpbr --colour .8,.5,.3 --length 1 --g .5 --eta 1.5 --to cycles --format csv 2>/dev/null | cut -d, -f2 | tail -n +2 | paste -sd,)"
from materialx, to coefficients

channel     sigma_a   sigma_s    g  eta  scattered  shows  as given
               1/mm      1/mm
-------  ----------  --------  ---  ---  ---------  -----  --------
      1  0.00295564  0.997044  0.5    1   0.997044    0.8         -
      2   0.0290847  0.970915  0.5    1   0.970915    0.5         -
      3   0.0883715  0.911628  0.5    1   0.911628    0.3         -

## Wrenninge's formula: the albedos are those of wrenninge() of core/tools/colours.py, and the furnace of tests/blender confirms them.
$ for g in 0 .5 .9; do dipole convert --from appleseed-glass --colour .05,.3,.6,.9 --length 1 --g $g --format csv; done
channel,sigma_a,sigma_s,g,eta,scattered,shown,shown_as_given
1,0.7839433643138699,0.2160566356861301,0,1.5,0.2160566356861301,0.014101164808305497,
2,0.24090984635594115,0.7590901536440589,0,1.5,0.7590901536440589,0.11602287181208905,
3,0.047243476883908286,0.9527565231160917,0,1.5,0.9527565231160917,0.3434871608881072,
4,7.72557099296578e-4,0.9992274429007034,0,1.5,0.9992274429007034,0.8527569474940901,
channel,sigma_a,sigma_s,g,eta,scattered,shown,shown_as_given
1,0.634919232460012,0.36508076753998797,0.5,1.5,0.36508076753998797,0.008758323710400036,
2,0.13502633110365048,0.8649736688963495,0.5,1.5,0.8649736688963495,0.10408394700496741,
3,0.02342443055147514,0.9765755694485249,0.5,1.5,0.9765755694485249,0.3429680256549759,
4,1e-6,0.999999,0.5,1.5,0.999999,0.9917096538618331,
channel,sigma_a,sigma_s,g,eta,scattered,shown,shown_as_given
1,0.2627626883356147,0.7372373116643853,0.9,1.5,0.7372373116643853,0.0061035327972556366,
2,0.03191930360997064,0.9680806963900294,0.9,1.5,0.9680806963900294,0.09401533740754929,
3,0.0037843207112121524,0.9962156792887878,0.9,1.5,0.9962156792887878,0.37885004146599605,
4,1e-6,0.999999,0.9,1.5,0.999999,0.9816206878466986,
! dipole convert: --from appleseed-glass: its formula knows no index
! dipole convert: --from appleseed-glass: its formula knows no index
! dipole convert: --from appleseed-glass: its formula knows no index

## Files of others: mean free paths of 2, 1 and .5 mm, and a second material, which is left out.
$ printf '<?xml version="1.0"?><materialx version="1.39"><open_pbr_surface name="m" type="surfaceshader"><input name="subsurface_color" type="color3" colorspace="srgb_texture" value="0.735357, 0.5, 0.2"/><input name="subsurface_radius" value="2"/> <input name="subsurface_radius_scale" value="1, 0.5, 0.25"/></open_pbr_surface><open_pbr_surface name="other"><input name="subsurface_radius" value="9"/></open_pbr_surface></materialx>' > m.openpbr; dipole convert --from openpbr m.openpbr
from openpbr, to coefficients

channel     sigma_a   sigma_s  g  eta  scattered      shows  as given
               1/mm      1/mm
-------  ----------  --------  -  ---  ---------  ---------  --------
      1  0.00883857  0.491161  0  1.5   0.982323        0.5         -
      2     0.11115   0.88885  0  1.5    0.88885   0.214041         -
      3     1.18439  0.815608  0  1.5   0.407804  0.0331048         -
! dipole convert: --from openpbr: renderers that use its example formula need --typed

$ echo '<m><open_pbr_surface><input name="subsurface_color" value=".4,.4,.4"/></open_pbr_surface></m>' > usual; dipole convert --from openpbr usual --format csv
channel,sigma_a,sigma_s,g,eta,scattered,shown,shown_as_given
1,0.033182688030972116,0.966817311969028,0,1.5,0.9668173119690279,0.40000000000000013,
2,0.06636537606194423,1.933634623938056,0,1.5,0.9668173119690279,0.40000000000000013,
3,0.13273075212388846,3.867269247876112,0,1.5,0.9668173119690279,0.40000000000000013,
! dipole convert: --from openpbr: renderers that use its example formula need --typed

## Lengths of 1, 1 / ln 2 and 1 / -ln .9 mm, g .2 and eta 1.4
$ printf '{"asset": {"version": "2.0"}, "materials": [{"extensions": {"KHR_materials_ior": {"ior": 1.4}, "KHR_materials_scatter": {"multiscatterColorFactor": [0.5, 0.5, 0.5], "scatterAnisotropy": 0.2}, "KHR_materials_volume": {"attenuationDistance": 0.001, "attenuationColor": [0.36787944, 0.5, 0.9]}}}]}' > m.gltf; dipole convert --from gltf m.gltf --format csv
channel,sigma_a,sigma_s,g,eta,scattered,shown,shown_as_given
1,0.07190442269513814,0.9280955804891724,0.2,1.4,0.9280955775338279,0.27197739939556875,
2,0.049840347702218395,0.6433068328577269,0.2,1.4,0.9280955775338279,0.2719773993955689,
3,0.007575887029114084,0.09778462862871219,0.2,1.4,0.9280955775338279,0.27197739939556875,
! dipole convert: --from gltf: the extension is a draft

## The strength halves the colours; a material without the extension stands before. Then one channel alone.
$ sed 's/"scatterAniso/"scatterStrengthFactor": 0.5, &/; s/\[{"ext/[{}, {"ext/' m.gltf > strong; dipole convert --from gltf strong --format csv; dipole convert --from gltf --colour .25,.25,.25 --length 1 --g .2 --eta 1.4 --format csv; sed 's/\[0.5, 0.5, 0.5\]/[0.5]/; s/\[0.36787944, 0.5, 0.9\]/[0.36787944]/' m.gltf > one; dipole convert --from gltf one --format csv
channel,sigma_a,sigma_s,g,eta,scattered,shown,shown_as_given
1,0.2612832487733459,0.7387167544109646,0.2,1.4,0.738716752058661,0.09665002190965719,
2,0.18110774663808418,0.512039433921861,0.2,1.4,0.738716752058661,0.09665002190965719,
3,0.027528937735851144,0.07783157792197513,0.2,1.4,0.738716752058661,0.09665002190965719,
channel,sigma_a,sigma_s,g,eta,scattered,shown,shown_as_given
1,2.612832479413389e-4,7.38716752058661e-4,0.2,1.4,0.738716752058661,0.09665002190965719,
2,2.612832479413389e-4,7.38716752058661e-4,0.2,1.4,0.738716752058661,0.09665002190965719,
3,2.612832479413389e-4,7.38716752058661e-4,0.2,1.4,0.738716752058661,0.09665002190965719,
channel,sigma_a,sigma_s,g,eta,scattered,shown,shown_as_given
1,0.07190442269513814,0.9280955804891724,0.2,1.4,0.9280955775338279,0.27197739939556875,
! dipole convert: --from gltf: the extension is a draft
! dipole convert: --from gltf: the extension is a draft
! dipole convert: --from gltf: the extension is a draft

## Paths of 1, 2 and 3 mm, of 2 mm, and of 1 mm if none is said
$ echo 'Material "subsurface" "rgb reflectance" [ .5 .4 .3 ] "rgb mfp" [1 2 3] "float eta" 1.4 "string name" "x" ' > m.pbrt; dipole convert --from pbrt m.pbrt --format csv; sed 's/1 2 3/2/' m.pbrt > one; dipole convert --from pbrt one --format csv; echo 'Material "diffuse" "rgb mfp" [9 9 9] Material "subsurface" "rgb reflectance" [.5 .4 .3]' > usual; dipole convert --from pbrt usual --format csv
channel,sigma_a,sigma_s,g,eta,scattered,shown,shown_as_given
1,0.022445286540018483,0.9775547134599816,0,1.4,0.9775547134599816,0.5000000000000003,
2,0.020762635210979534,0.4792373647890204,0,1.4,0.9584747295780409,0.3999999999999997,
3,0.025509608033444403,0.3078237252998889,0,1.4,0.9234711758996668,0.30000000000000027,
channel,sigma_a,sigma_s,g,eta,scattered,shown,shown_as_given
1,0.011222643270009242,0.4887773567299908,0,1.4,0.9775547134599816,0.5000000000000003,
2,0.020762635210979534,0.4792373647890204,0,1.4,0.9584747295780409,0.3999999999999997,
3,0.038264412050166605,0.4617355879498334,0,1.4,0.9234711758996668,0.30000000000000004,
channel,sigma_a,sigma_s,g,eta,scattered,shown,shown_as_given
1,0.026661130339025577,0.9733388696609745,0,1.33,0.9733388696609744,0.5000000000000006,
2,0.04880128336456888,0.9511987166354312,0,1.33,0.9511987166354311,0.4000000000000003,
3,0.08869599472614954,0.9113040052738506,0,1.33,0.9113040052738505,0.2999999999999998,
! dipole convert: --from pbrt: pbrt inverts by a table of its own, within .14
! dipole convert: --from pbrt: pbrt inverts by a table of its own, within .14
! dipole convert: --from pbrt: pbrt inverts by a table of its own, within .14

## Files that end early, that say what cannot be taken, and one that is not there
$ printf %.45s "$(cat m.pbrt)" > e.pbrt; cp m.openpbr e.openpbr; cp m.gltf e.gltf; for name in openpbr gltf pbrt; do s=$(wc -c < e.$name); for n in $(seq 0 $((s / 4)) $((s - 2))); do head -c $n e.$name > part; dipole convert --from $name part 2> said; echo $name $? $(grep -c '^dipole convert: part: ' said); done; done | uniq -c
      1 openpbr 1 0
      4 openpbr 1 1
      1 gltf 1 0
      4 gltf 1 1
      1 pbrt 1 0
      3 pbrt 1 1

$ sed 's/value="0.735357, 0.5, 0.2"/nodegraph="NG"/' m.openpbr > wrong; dipole convert --from openpbr wrong; sed s/_scatter/_sheen/ m.gltf > wrong; dipole convert --from gltf wrong; sed 's/\[ .5 .4 .3 \]/[]/' m.pbrt > wrong; dipole convert --from pbrt wrong; : > wrong; for name in openpbr gltf pbrt; do dipole convert --from $name wrong; dipole convert --from $name none; done
! dipole convert: wrong: subsurface_color is connected to a node, or is no number: give --colour
! dipole convert: wrong: no material has the extension KHR_materials_scatter
! dipole convert: wrong: reflectance is connected to a node, or is no number: give --colour
! dipole convert: wrong is empty
! dipole convert: cannot read none: No such file or directory
! dipole convert: wrong is empty
! dipole convert: cannot read none: No such file or directory
! dipole convert: wrong is empty
! dipole convert: cannot read none: No such file or directory
? 1

## From each convention to the next, from what the last one wrote: every one is left and entered, and the medium stays.
$ for g in 0 .7; do from='coefficients --sigma-a .01,.2,2 --sigma-s 5'; for to in $(dipole convert --from none --colour 1 --length 1 2>&1 | sed -n 's/.*there are coefficients//; s/,//gp') coefficients; do for unit in '--unit 2.5' ''; do dipole convert --from $from --to $to --g $g --eta 1.4 $unit --format csv > x 2>> e && break; done; [ $to = coefficients ] && at=2 || at=4; tail -n +2 x | cut -d, -f$at,$((at + 1)) | awk -F, -v to=$to '{ printf "%s %.4g %.4g", NR == 1 ? to : ",", $1, $2 } END { print "" }'; from="$to --colour $(tail -n +2 x | cut -d, -f2 | paste -sd,) --length $(tail -n +2 x | cut -d, -f3 | paste -sd,)"; done; done
openpbr 0.01 5, 0.2 5, 2 5
materialx 0.01 5, 0.2 5, 2 5
standard-surface 0.01 5, 0.2 5, 2 5
cycles 0.01 5, 0.2 5, 2 5
blender-skin 0.01 5, 0.2 5, 2 5
blender-burley 0.01 5, 0.2 5, 2 5
gltf 0.01 5, 0.2 5, 2 5
gltf-volume-scatter 0.01 5, 0.2 5, 2 5
dspbr 0.01 5, 0.2 5, 2 5
pxr 0.01 5, 0.2 5, 2 5
pbrt 0.01 5, 0.2 5, 2 5
appleseed-diffuse 0.01 5, 0.2 5, 2 5
appleseed-glass 0.01 5, 0.2 5, 2 5
unreal 0.01 5, 0.2 5, 2 5
unity 0.01 5, 0.2 5, 2 5
coefficients 0.01 5, 0.2 5, 2 5
openpbr 0.01 5, 0.2 5, 2 5
materialx 0.01 5, 0.2 5, 2 5
standard-surface 0.01 5, 0.2 5, 2 5
cycles 0.01 5, 0.2 5, 2 5
blender-skin 0.01 5, 0.2 5, 2 5
blender-burley 0.01 5, 0.2 5, 2 5
gltf 0.01 5, 0.2 5, 2 5
gltf-volume-scatter 0.01 5, 0.2 5, 2 5
dspbr 0.01 5, 0.2 5, 2 5
pxr 0.01 5, 0.2 5, 2 5
pbrt 0.01 5, 0.2 5, 2 5
appleseed-diffuse 0.01 5, 0.2 5, 2 5
appleseed-glass 0.01 5, 0.2 5, 2 5
unreal 0.01 5, 0.2 5, 2 5
unity 0.01 5, 0.2 5, 2 5
coefficients 0.01 5, 0.2 5, 2 5

## A file that is written has the inputs of MaterialX 1.39's definitions (libraries/bxdf, libraries/pbrlib) with their types, and is read as the same medium. materialx cannot say the index.
$ for name in openpbr materialx standard-surface gltf gltf-volume-scatter pbrt; do dipole convert --from coefficients --sigma-a .01,.2,2 --sigma-s 5 --g .3 --eta 1.45 --to $name --format native 2>> e > m; cat m; [ $name = materialx ] && eta='--eta 1.45' || eta=; dipole convert --from $name m $eta --format csv 2>> e | cut -d, -f2-5 | awk -F, 'NR > 1 { printf "%.4g %.4g %g %g\n", $1, $2, $3, $4 }'; done; sort -u e
<?xml version="1.0"?>
<materialx version="1.39">
  <open_pbr_surface name="subsurface" type="surfaceshader">
    <input name="subsurface_weight" type="float" value="1" />
    <input name="subsurface_color" type="color3" value="0.755621112, 0.334046467, 0.0694276377" />
    <input name="subsurface_radius_scale" type="color3" value="1, 0.963461538, 0.715714286" />
    <input name="subsurface_radius" type="float" value="0.199600798" />
    <input name="subsurface_scatter_anisotropy" type="float" value="0.3" />
    <input name="specular_ior" type="float" value="1.45" />
  </open_pbr_surface>
</materialx>
0.01 5 0.3 1.45
0.2 5 0.3 1.45
2 5 0.3 1.45
<?xml version="1.0"?>
<materialx version="1.39">
  <subsurface_bsdf name="subsurface" type="BSDF">
    <input name="color" type="color3" value="0.884371694, 0.583875803, 0.213248208" />
    <input name="radius" type="color3" value="0.199600798, 0.192307692, 0.142857143" />
    <input name="anisotropy" type="float" value="0.3" />
  </subsurface_bsdf>
</materialx>
0.01 5 0.3 1.45
0.2 5 0.3 1.45
2 5 0.3 1.45
<?xml version="1.0"?>
<materialx version="1.39">
  <standard_surface name="surface" type="surfaceshader">
    <input name="subsurface" type="float" value="1" />
    <input name="subsurface_color" type="color3" value="0.884371694, 0.583875803, 0.213248208" />
    <input name="subsurface_radius" type="color3" value="1, 0.963461538, 0.715714286" />
    <input name="subsurface_scale" type="float" value="0.199600798" />
    <input name="subsurface_anisotropy" type="float" value="0.3" />
    <input name="specular_IOR" type="float" value="1.45" />
  </standard_surface>
</materialx>
0.01 5 0.3 1.45
0.2 5 0.3 1.45
2 5 0.3 1.45
{"extensions": {
  "KHR_materials_scatter": {"multiscatterColorFactor": [0.884371694, 0.583875803, 0.213248208], "scatterAnisotropy": 0.3, "scatterStrengthFactor": 1},
  "KHR_materials_volume": {"attenuationDistance": 0.000199600798, "attenuationColor": [0.367879441, 0.354189162, 0.247287021]},
  "KHR_materials_ior": {"ior": 1.45}}}
0.01 5 0.3 1.45
0.2 5 0.3 1.45
2 5 0.3 1.45
{"extensions": {
  "KHR_materials_volume_scatter": {"multiscatterColor": [0.902229564, 0.63602923, 0.265101194], "scatterAnisotropy": 0.3},
  "KHR_materials_volume": {"attenuationDistance": 0.000199600798, "attenuationColor": [0.367879441, 0.354189162, 0.247287021]},
  "KHR_materials_ior": {"ior": 1.45}}}
0.01 5 0.3 1.45
0.2 5 0.3 1.45
2 5 0.3 1.45
Material "subsurface" "rgb reflectance" [ 0.755621112 0.334046467 0.0694276377 ] "rgb mfp" [ 0.199600798 0.192307692 0.142857143 ] "float g" [ 0.3 ] "float eta" [ 1.45 ]
0.01 5 0.3 1.45
0.2 5 0.3 1.45
2 5 0.3 1.45
`dipole convert --help` says more.
dipole convert: --from appleseed-glass: its formula knows no index
dipole convert: --from blender-skin: its walk knows no interface; light that leaves is up to 4 % less or more, by Roughness, right at .4; Blender 4 refracts half of it on the way in (Random Walk (Skin))
dipole convert: --from cycles: its walk lets light out without refraction: colours to type make up for it at normal incidence, and come out up to .05 brighter in a dome
dipole convert: --from dspbr: its formula ignores g
dipole convert: --from gltf-volume-scatter: its formula ignores g, and a later draft replaces it
dipole convert: --from gltf: the extension is a draft
dipole convert: --from openpbr: renderers that use its example formula need --typed
dipole convert: --from pbrt: pbrt inverts by a table of its own, within .14
dipole convert: --from pxr: not settled for its other models: their formulas are not published
dipole convert: --from standard-surface: not settled: it leaves the formula to the renderer, and Arnold's is not published
dipole convert: --from unreal: not settled: WorldUnitScale multiplies the length
dipole convert: --unit: the lengths of gltf and gltf-volume-scatter have units of their own: leave it out
dipole convert: --unit: the lengths of pxr and pbrt have units of their own: leave it out
dipole convert: --unit: the lengths of unity and coefficients have units of their own: leave it out
dipole convert: --unit: the lengths of unreal and unity have units of their own: leave it out
dipole convert: appleseed-diffuse cannot say the index, 1.4
dipole convert: blender-burley cannot say g: its length is that of g 0.7
dipole convert: blender-burley cannot say the index, 1.4
dipole convert: blender-burley has Burley's profile alone: the length is that whose shadow edge is the nearest
dipole convert: materialx cannot say the index, 1.4
dipole convert: materialx cannot say the index, 1.45
dipole convert: pxr cannot say g: its length is that of g 0.7
dipole convert: unity cannot say g: its length is that of g 0.7
dipole convert: unity has Burley's profile alone: the length is that whose shadow edge is the nearest
dipole convert: unreal cannot say g: its length is that of g 0.7
dipole convert: unreal has Burley's profile alone: the length is that whose shadow edge is the nearest
