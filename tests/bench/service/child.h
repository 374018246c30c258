/* child: starts and ends the processes of a benchmark. Each child is pinned to a core, ends when
 * the benchmark ends for whatever reason, and leaves no file behind.
 *
 * Servers run on the first core that this process may use and clients on the last one, so that the
 * scheduler moves neither. With a single core both run on it. No process burns spare time to keep
 * idle cores awake: then each wake-up would be an interrupt, which a virtual machine delivers
 * slowly, whereas an idle virtual core polls for a while before it sleeps.
 */
#ifndef DIPOLED_BENCH_SERVICE_CHILD_H
#define DIPOLED_BENCH_SERVICE_CHILD_H

#include <stdint.h>
#include <sys/types.h>

enum child_side {
  CHILD_ANYWHERE, /* all cores that the benchmark was started on */
  CHILD_SERVER,
  CHILD_CLIENT,
};

/* Makes the temporary folder. After limit_s seconds the benchmark is stopped together with all its
 * children. */
void child_begin(unsigned limit_s);

/* Ends all children, removes the folder and unpins the calling process. This also happens when the
 * process exits or is stopped by a signal. */
void child_end_all(void);

/* Returns the path of a file in the temporary folder. child_end_all() removes the file; the string
 * lives as long as the process. */
const char *child_path(const char *name);

/* Pins the calling process. */
void child_pin(enum child_side side);

/* Like fork(), but the child is pinned to its side's core. It must leave with _exit(). */
pid_t child_fork(enum child_side side);

/* Starts a program; a name without a slash is looked up in PATH. Its output goes to the file log.
 * Its environment lacks DIPOLED and DIPOLED_..., which dipoled would read as options. */
pid_t child_run(enum child_side side, char *const *arguments, const char *log);

/* Sends the child SIGTERM, and SIGKILL if it has not ended a few seconds later. */
void child_end(pid_t child);

/* Stops the benchmark if the child has ended; the message contains name. */
void child_must_run(pid_t child, const char *name);

/* Returns the processor time that the child has used so far. */
uint64_t child_cpu_ns(pid_t child);

#endif
