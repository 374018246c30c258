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

$ dipole convert --colour .5 --length 1
! dipole convert: give --from: a convention, or coefficients
! `dipole convert --help` says more.
? 2

$ dipole convert --from openpbr --colour .5
! dipole convert: give --colour, and --length for all or each of its channels
! `dipole convert --help` says more.
? 2

$ dipole convert --from openpbr --colour 1.5 --length 1
! dipole convert: --colour: 1.5 is not from 0 to 1: divide values of 8 bits by 255
! `dipole convert --help` says more.
? 2

$ dipole convert --from openpbr --colour .5 --length 1 --g -.1 --to appleseed-glass
! dipole convert: --g: the formula of appleseed-glass is for g from 0 on
! `dipole convert --help` says more.
? 2

$ dipole convert --from openbr --colour .5 --length 1
! dipole convert: --from: 'openbr' is unknown; there are coefficients, openpbr, materialx, standard-surface, cycles, blender-skin, blender-burley, gltf, gltf-volume-scatter, dspbr, pxr, pbrt, appleseed-diffuse, appleseed-glass, unreal, unity
! `dipole convert --help` says more.
? 2

$ dipole convert --from openpbr --colour .5 --length 1 --sigma-a 1
! dipole convert: --medium, --sigma-a, --sigma-s: these are of --from coefficients
! `dipole convert --help` says more.
? 2

$ dipole convert --from openpbr --colour .5 --length 1 --unit inch
! dipole convert: --unit: mm, cm, m, or a number of millimetres
! `dipole convert --help` says more.
? 2

$ dipole convert --from openpbr --colour .5 --length 1 --to gltf --format native
! dipole convert: --format native: give three channels, not 1
! `dipole convert --help` says more.
? 2

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
