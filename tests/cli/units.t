## The systemd units as they are installed: they have no faults, and confine the daemon.
$ build=$(dirname "$(command -v dipoled)"); build=${build%/leaks}; MAKEFLAGS= MFLAGS= MAKELEVEL= MAKEOVERRIDES= make -s -C $REPOSITORY install BUILD=$(realpath --relative-to=$REPOSITORY $build) DESTDIR=$PWD UNITDIR=/units > /dev/null; sed -i -E "s,^ExecStart=/[^ ]+/dipoled$,ExecStart=$build/dipoled," units/*.service; ls units; grep -c "^ExecStart=$build/dipoled$" units/*.service
dipoled.service
dipoled.socket
dipoled@.service
units/dipoled.service:1
units/dipoled@.service:1

$ cd units; if command -v systemd-analyze > /dev/null; then SYSTEMD_UNIT_PATH=$PWD: systemd-analyze verify --man=no $PWD/dipoled.service $PWD/dipoled@.service $PWD/dipoled.socket; fi

## The scale of exposure goes up to 10, for a service that may do everything; the threshold is in tenths.
$ cd units; if command -v systemd-analyze > /dev/null; then for one in dipoled.service dipoled@.service; do systemd-analyze security --offline=yes --threshold=20 $PWD/$one > shown || cat shown; done; fi

## The socket is where a daemon of root listens, so that clients need not know who has started it. A port would be open to everybody on the machine.
$ grep -E '^(Listen|SocketMode|SocketGroup)' units/dipoled.socket; sed -n 's,#define DEFAULT_SOCKET "\(.*\)",/run/\1,p' $REPOSITORY/server/main.c; grep -v '^#' $REPOSITORY/server/dipoled.sysusers
ListenStream=/run/dipoled.sock
SocketMode=0660
SocketGroup=dipole
/run/dipoled.sock
g dipole -

## An instance has its own socket, folder and options, and is confined like the one daemon.
$ grep -hE '#@|#!' units/*.service; for one in dipoled dipoled@; do grep -E '^[A-Za-z]+=' units/$one.service | LC_ALL=C sort > $one.settings; done; diff dipoled.settings dipoled@.settings | grep '^[<>]'
< After=dipoled.socket network.target
< Also=dipoled.socket
> After=network.target
< Description=Subsurface-scattering profiles for clients
> Description=Subsurface-scattering profiles for clients, instance %i
< EnvironmentFile=-/etc/default/dipoled
> Environment=DIPOLED_LISTEN=unix:%t/dipoled-%i/dipoled.sock
> EnvironmentFile=-/etc/default/dipoled-%i
> Group=dipole
< Requires=dipoled.socket
< RuntimeDirectory=dipoled
> RuntimeDirectory=dipoled-%i
< UMask=0077
> UMask=0117
