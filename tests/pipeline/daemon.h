/* daemon: the dipoled beside this program, on a Unix socket of its own. */
#ifndef DIPOLED_TESTS_PIPELINE_DAEMON_H
#define DIPOLED_TESTS_PIPELINE_DAEMON_H

#include <stdbool.h>
#include <sys/types.h>

typedef struct daemon_process {
  pid_t pid;
  char folder[64];
  char address[96]; /* for dipole_open(); it may take a moment until somebody listens there */
} daemon_process;

/* Starts it; it ends with this program, whatever becomes of that. False: it says why. */
bool daemon_start(daemon_process *daemon);

/* Asks it to stop. False: it did not end well. */
bool daemon_stop(daemon_process *daemon);

#endif
