## dipoled: what it refuses at its start, and says then. The loops print each exit status.
$ dipoled --max-medium 5; dipoled --wrokers; dipoled --wrokers=3; dipoled --worker-s; dipoled --nothing-like-it; dipoled --max-media; dipoled tcp:127.0.0.1:0
! dipoled: unrecognized option '--max-medium'
! dipoled --help lists the options
! dipoled: unrecognized option '--wrokers'
! dipoled --help lists the options
! dipoled: unrecognized option '--wrokers=3'
! dipoled --help lists the options
! dipoled: unrecognized option '--worker-s'
! dipoled --help lists the options
! dipoled: unrecognized option '--nothing-like-it'
! dipoled --help lists the options
! dipoled: option '--max-media' requires an argument
! dipoled --help lists the options
! dipoled: 'tcp:127.0.0.1:0' is not an option; dipoled --help lists them
? 2

$ dipoled --log-level loud; dipoled --isa pentium; dipoled --fd 99
! dipoled: --log-level is error or info, not 'loud'
! dipoled: --isa is one that this machine can run, not 'pentium': portable ...
! dipoled: --fd 99 is not the number of a connected stream socket that this process has inherited
? 1

$ for one in '' ' 5' '5 ' -5 +5 1.5 1e3 0x10 five 999999999999999999999999999999; do dipoled --max-media "$one" || echo $?; done
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
! dipoled: --max-media is a number from 1 to 1048576, not ''
! dipoled: --max-media is a number from 1 to 1048576, not ' 5'
! dipoled: --max-media is a number from 1 to 1048576, not '5 '
! dipoled: --max-media is a number from 1 to 1048576, not '-5'
! dipoled: --max-media is a number from 1 to 1048576, not '+5'
! dipoled: --max-media is a number from 1 to 1048576, not '1.5'
! dipoled: --max-media is a number from 1 to 1048576, not '1e3'
! dipoled: --max-media is a number from 1 to 1048576, not '0x10'
! dipoled: --max-media is a number from 1 to 1048576, not 'five'
! dipoled: --max-media is a number from 1 to 1048576, not '999999999999999999999999999999'

$ for one in WORKER LOGLEVEL max_media '' PORT SERVICE_HOSTS; do env "DIPOLED_$one=3" DIPOLED_WORKERS=2 dipoled || echo $?; done
2
2
2
2
2
2
! dipoled: the environment variable DIPOLED_WORKER is no option; dipoled --help lists them
! dipoled: the environment variable DIPOLED_LOGLEVEL is no option; dipoled --help lists them
! dipoled: the environment variable DIPOLED_max_media is no option; dipoled --help lists them
! dipoled: the environment variable DIPOLED_ is no option; dipoled --help lists them
! dipoled: the environment variable DIPOLED_PORT is no option; dipoled --help lists them
! dipoled: the environment variable DIPOLED_SERVICE_HOSTS is no option; dipoled --help lists them

## Addresses.
$ for one in nonsense '' http://localhost:80 unix: unix:/no/such/folder/s "unix:/$(printf 'x%.0s' $(seq 200))"; do dipoled --listen "$one" || echo $?; done
1
1
1
1
1
1
! dipoled: cannot listen at nonsense: write unix:PATH, tcp:HOST:PORT or tls:HOST:PORT, as in tcp:127.0.0.1:4817
! dipoled: cannot listen at : write unix:PATH, tcp:HOST:PORT or tls:HOST:PORT, as in tcp:127.0.0.1:4817
! dipoled: cannot listen at http://localhost:80: write unix:PATH, tcp:HOST:PORT or tls:HOST:PORT, as in tcp:127.0.0.1:4817
! dipoled: cannot listen at unix:: the path is empty or longer than a socket's path may be (107 bytes)
! dipoled: cannot listen at unix:/no/such/folder/s: No such file or directory
! dipoled: cannot listen at unix:/xxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxx: the path is empty or longer than a socket's path may be (107 bytes)

$ for one in '' 127.0.0.1 127.0.0.1: 127.0.0.1:65536 127.0.0.1:-1 127.0.0.1:port :0 256.1.1.1:0 "$(printf '1%.0s' $(seq 255)):0" "$(printf '1%.0s' $(seq 256)):0"; do dipoled --listen "tcp:$one" || echo $?; done
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
! dipoled: cannot listen at tcp:: write a host and a port, as in 127.0.0.1:4817 or [::1]:4817
! dipoled: cannot listen at tcp:127.0.0.1: write a host and a port, as in 127.0.0.1:4817 or [::1]:4817
! dipoled: cannot listen at tcp:127.0.0.1:: write a host and a port, as in 127.0.0.1:4817 or [::1]:4817
! dipoled: cannot listen at tcp:127.0.0.1:65536: the port, behind the last colon, has to be a number from 0 to 65535
! dipoled: cannot listen at tcp:127.0.0.1:-1: the port, behind the last colon, has to be a number from 0 to 65535
! dipoled: cannot listen at tcp:127.0.0.1:port: the port, behind the last colon, has to be a number from 0 to 65535
! dipoled: cannot listen at tcp::0: write a host and a port, as in 127.0.0.1:4817 or [::1]:4817
! dipoled: cannot listen at tcp:256.1.1.1:0: no host has this name
! dipoled: cannot listen at tcp:111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111:0: no host has this name
! dipoled: cannot listen at tcp:1111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111111:0: write a host and a port, as in 127.0.0.1:4817 or [::1]:4817

$ for one in x -1 '' 999 1 0x3; do dipoled --fd "$one" || echo $?; done
1
1
1
1
1
1
! dipoled: --fd x is not the number of a connected stream socket that this process has inherited
! dipoled: --fd -1 is not the number of a connected stream socket that this process has inherited
! dipoled: --fd  is not the number of a connected stream socket that this process has inherited
! dipoled: --fd 999 is not the number of a connected stream socket that this process has inherited
! dipoled: --fd 1 is not the number of a connected stream socket that this process has inherited
! dipoled: --fd 0x3 is not the number of a connected stream socket that this process has inherited

$ for one in localhost 10.0.0.0/33 10.0.0.0/ ''; do dipoled --listen tcp:127.0.0.1:0 --allow "$one" || echo $?; done
2
2
2
2
! dipoled: --allow takes numeric addresses, as 192.0.2.7 or 192.0.2.0/24, not 'localhost'
! dipoled: --allow takes numeric addresses, as 192.0.2.7 or 192.0.2.0/24, not '10.0.0.0/33'
! dipoled: --allow takes numeric addresses, as 192.0.2.7 or 192.0.2.0/24, not '10.0.0.0/'
! dipoled: --allow takes numeric addresses, as 192.0.2.7 or 192.0.2.0/24, not ''

## Modbus.
$ export DIPOLED_LISTEN=unix:w DIPOLED_LOG_LEVEL=error; for one in 127.0.0.1:502 tcp:127.0.0.1 unix:/nonexistent rtu:,9600; do dipoled --modbus "$one" || echo $?; done
1
1
1
1
! dipoled: cannot listen at 127.0.0.1:502: Modbus is served at tcp:HOST:PORT, tls:HOST:PORT or rtu:DEVICE[,BAUD[,PARITY[,UNIT]]]
! dipoled: cannot listen at tcp:127.0.0.1: write a host and a port, as in 127.0.0.1:4817 or [::1]:4817
! dipoled: cannot listen at unix:/nonexistent: Modbus is served at tcp:HOST:PORT, tls:HOST:PORT or rtu:DEVICE[,BAUD[,PARITY[,UNIT]]]
! dipoled: --modbus rtu:,9600: the form is rtu:DEVICE[,BAUD[,PARITY[,UNIT]]][,rts=high|low][,rts-delay-ms=N]

$ dipoled --log-level error --listen unix:w --modbus "rtu:/dev/null,19200$(printf ',rts=low%.0s' $(seq 62)),rts=up" 2>&1 | sed 's/.*up: //'
the form is rtu:DEVICE[,BAUD[,PARITY[,UNIT]]][,rts=high|low][,rts-delay-ms=N]

$ export DIPOLED_LISTEN=unix:w DIPOLED_LOG_LEVEL=error; for one in 9601,N 9600,X 9600,N,0 9600,N,248 9600,N,1,2 9600,N3 9600,N,rts=up 9600,N,1,rts=high,rts-delay-ms=1001 9600,N,1,rts-delay-ms=1; do dipoled --modbus "rtu:/dev/null,$one" || echo $?; done
1
1
1
1
1
1
1
1
1
! dipoled: --modbus rtu:/dev/null,9601,N: BAUD is 1200, 2400, 4800, ... 115200, 230400, 460800 or 921600
! dipoled: --modbus rtu:/dev/null,9600,X: PARITY is N, E or O, maybe with the number of stop bits: N1 or E2
! dipoled: --modbus rtu:/dev/null,9600,N,0: UNIT is 1 to 247
! dipoled: --modbus rtu:/dev/null,9600,N,248: UNIT is 1 to 247
! dipoled: --modbus rtu:/dev/null,9600,N,1,2: the form is rtu:DEVICE[,BAUD[,PARITY[,UNIT]]][,rts=high|low][,rts-delay-ms=N]
! dipoled: --modbus rtu:/dev/null,9600,N3: PARITY is N, E or O, maybe with the number of stop bits: N1 or E2
! dipoled: --modbus rtu:/dev/null,9600,N,rts=up: rts is high or low: RTS while the daemon sends
! dipoled: --modbus rtu:/dev/null,9600,N,1,rts=high,rts-delay-ms=1001: rts-delay-ms is 0 to 1000
! dipoled: --modbus rtu:/dev/null,9600,N,1,rts-delay-ms=1: rts-delay-ms needs rts=high or rts=low

$ export DIPOLED_LISTEN=unix:w DIPOLED_LOG_LEVEL=error; for one in localhost 10.0.0.0/33 10.0.0.0/; do dipoled --modbus tcp:127.0.0.1:0 --modbus-allow "$one" || echo $?; done
1
1
1
! dipoled: --modbus-allow takes numeric addresses, as 192.0.2.7 or 192.0.2.0/24, not 'localhost'
! dipoled: --modbus-allow takes numeric addresses, as 192.0.2.7 or 192.0.2.0/24, not '10.0.0.0/33'
! dipoled: --modbus-allow takes numeric addresses, as 192.0.2.7 or 192.0.2.0/24, not '10.0.0.0/'

$ export DIPOLED_LISTEN=unix:w DIPOLED_LOG_LEVEL=error; dipoled --modbus tcp:127.0.0.1:0 --modbus-allow-write localhost
! dipoled: --modbus-allow-write takes numeric addresses, as 192.0.2.7 or 192.0.2.0/24, not 'localhost'
? 1

## HTTP.
$ for one in '' '*' farm7:8017 farm7. http://farm7 '[::1]'; do dipoled --http 127.0.0.1:0 --http-name "$one" || echo $?; done
2
2
2
2
2
2
! dipoled: --http-name is a name alone, as farm7.example, not ''
! dipoled: --http-name is a name alone, as farm7.example, not '*'
! dipoled: --http-name is a name alone, as farm7.example, not 'farm7:8017'
! dipoled: --http-name is a name alone, as farm7.example, not 'farm7.'
! dipoled: --http-name is a name alone, as farm7.example, not 'http://farm7'
! dipoled: --http-name is a name alone, as farm7.example, not '[::1]'

## Help and the version come before any start.
$ dipoled --version
dipoled 0.1.0

$ dipoled --help --listen nonsense | head -n 1
dipoled 0.1.0: evaluates subsurface-scattering profiles R(r) for clients.

$ export DIPOLED_LOG_LEVEL=error; for one in 127.0.0.1: '' 127.0.0.1:x 127.0.0.1:65536 no.such.host.invalid:0 tcp:127.0.0.1:0; do dipoled --listen unix:w --metrics "$one"; done
! dipoled: --metrics 127.0.0.1:: write a host and a port, as in 127.0.0.1:4817 or [::1]:4817. Write HOST:PORT, or a PORT of this machine
! dipoled: --metrics : write a host and a port, as in 127.0.0.1:4817 or [::1]:4817. Write HOST:PORT, or a PORT of this machine
! dipoled: --metrics 127.0.0.1:x: the port, behind the last colon, has to be a number from 0 to 65535. Write HOST:PORT, or a PORT of this machine
! dipoled: --metrics 127.0.0.1:65536: the port, behind the last colon, has to be a number from 0 to 65535. Write HOST:PORT, or a PORT of this machine
! dipoled: --metrics no.such.host.invalid:0: ... Write HOST:PORT, or a PORT of this machine
! dipoled: --metrics tcp:127.0.0.1:0: ... Write HOST:PORT, or a PORT of this machine
? 1

$ for one in http metrics; do dipoled --listen unix:w --$one 127.0.0.1:0 --$one 127.0.0.1:0 || echo $?; done
2
2
! dipoled: --http is given twice, and takes one HOST:PORT
! dipoled: --metrics is given twice, and takes one HOST:PORT

## All addresses, or none; other files are left alone.
$ dipoled --log-level error --listen unix:first --listen tcp:127.0.0.1:nonsense; test -e first || echo none
none
! dipoled: cannot listen at tcp:127.0.0.1:nonsense: the port, behind the last colon, has to be a number from 0 to 65535

$ echo 'not a socket' > precious; mkdir folder; ln -s nowhere link; for one in precious folder link; do dipoled --log-level error --listen unix:$one; done; cat precious; ls -Fd folder link
not a socket
folder/
link@
! dipoled: cannot listen at unix:precious: Address already in use: end the program that has it, or give another address (--listen, --http, --metrics, --modbus or --scpi)
! dipoled: cannot listen at unix:folder: Address already in use: end the program that has it, or give another address (--listen, --http, --metrics, --modbus or --scpi)
! dipoled: cannot listen at unix:link: Address already in use: end the program that has it, or give another address (--listen, --http, --metrics, --modbus or --scpi)

## Files of media
$ export DIPOLED_LOG_LEVEL=error; for one in 'skin1 1,2,0,1.3' 'a 1,2,0,1.3 1,2,0,1.3' 'a 1,2,0' 'a' 'a red 1,2,0,1.3\nb 1,2,0,1.3' '\na red 1,2,0,1.3' 'a 1,2,0,1e4' 'aaaaaaaaaaaaaaaaa 1,2,0,1.3' 'a red 1,2,0,1.3\na red 1,2,0,1.3' 'a red 1,2,0,1.3\na green 1,2,0,1.3,1 1,2,0,1.3' "a$(printf ' 1,2,0,1.3,1%.0s' $(seq 9))" "$(printf 'm%d 1,2,0,1.3\\n' $(seq 257))" "$(printf 'a%.0s' $(seq 2100))"; do printf "$one" > media; dipoled --listen unix:w --media media || echo $?; done
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
1
1
! dipoled: media: line 1: the name is taken
! dipoled: media: line 1: above 0: only the last layer may be a half space
! dipoled: media: line 1: layers are SIGMA_A,SIGMA_S,G,ETA[,THICKNESS_MM]
! dipoled: media: line 1: layers are SIGMA_A,SIGMA_S,G,ETA[,THICKNESS_MM]
! dipoled: media: line 2: the medium above needs a line for red, green and blue each
! dipoled: media: the last medium lacks a colour
! dipoled: media: line 1: 0.001 to 1000
! dipoled: media: line 1: a name has at most 16 bytes
! dipoled: media: line 2: the medium above needs a line for red, green and blue each
! dipoled: media: line 2: red, green and blue have as many layers each
! dipoled: media: line 1: layers are SIGMA_A,SIGMA_S,G,ETA[,THICKNESS_MM]
! dipoled: media: line 257: a file has at most 256 media
! dipoled: media: line 1: the line is too long

## Certificates need an address with TLS.
$ for one in '--certificate a --key b --client-ca c' '--certificate a --key b' '--key b'; do dipoled --log-level error --listen unix:w $one || echo $?; done
1
1
1
! dipoled: --client-ca: no address has TLS: give --listen or --modbus tls:HOST:PORT, too
! dipoled: --certificate: no address has TLS: give --listen or --modbus tls:HOST:PORT, too
! dipoled: --key: no address has TLS: give --listen or --modbus tls:HOST:PORT, too
