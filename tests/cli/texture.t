## dipole texture: what it refuses.
$ printf 'PF\n2 2\n-1.0\n%048d' 0 > in.pfm; dipole texture in.pfm || echo $?; dipole texture in.pfm out.pfm || echo $?; for one in 'out.png --mean-free-path 1' 'out.exr --mean-free-path 1' 'out.pfm --mean-free-path 1,2' 'out.pfm --mean-free-path 1 --light moon' 'out.pfm --mean-free-path 1 --coefficients colour' 'no/out.pfm --mean-free-path 1'; do dipole texture in.pfm $one || echo $?; done
2
2
2
2
2
2
2
1
! dipole texture: name two files: the image that is read, and the image that is written
! `dipole texture --help` says more.
! dipole texture: give exactly one of --mean-free-path, --diffuse-mean-free-path, --classical-diffuse-path and --extinction-path
! `dipole texture --help` says more.
! dipole texture: out.png: the name of the image that is written ends with .pfm, or with .png if --coefficients is scattered
! `dipole texture --help` says more.
! dipole texture: out.exr: the name of the image that is written ends with .pfm, or with .png if --coefficients is scattered
! `dipole texture --help` says more.
! dipole texture: --mean-free-path has 2 values: give one, or three for red, green and blue
! `dipole texture --help` says more.
! dipole texture: --light: 'moon' is unknown; this daemon has beam, diffuse
! `dipole texture --help` says more.
! dipole texture: --coefficients: 'colour' is unknown; this daemon has sigma_a, sigma_s, scattered
! `dipole texture --help` says more.
! dipole texture: no/out.sigma_a.pfm: No such file or directory

$ for one in 'none' 'PF\n0 2\n-1.0\n' 'PF\n99999 2\n-1.0\n' 'PF\n2147483650 2\n-1.0\n' 'PF\n65536 65536\n-1.0\n0' 'PF\n2 2\n1.0\n' 'PF\n2 2\n-1.0\n0' '\211PNG\r\n\032\n00000000'; do printf "$one" > x; dipole texture x out.pfm --mean-free-path 1 || echo $?; done; dipole texture missing.png out.pfm --mean-free-path 1
1
1
1
1
1
1
1
1
! dipole texture: x: it is neither a PNG nor a PFM
! dipole texture: x: its width and height are not from 1 to 65536
! dipole texture: x: its width and height are not from 1 to 65536
! dipole texture: x: its width and height are not from 1 to 65536
! dipole texture: x: the PFM ends too early
! dipole texture: x: this PFM is big-endian: write it as little-endian, with a negative scale
! dipole texture: x: the PFM ends too early
! dipole texture: x: [30][30][30][30]: invalid chunk type
! dipole texture: missing.png: No such file or directory
? 1
