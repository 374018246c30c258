/* child: the processes that a benchmark starts. Each is pinned to its side's core, ends with the
 * benchmark however that ends, and leaves no file behind.
 *
 * Two sides: servers on the first core that this process may use, clients on the last, so that the
 * scheduler moves neither (with a single core both are on it). A process that burns the time which
 * nobody wants would keep idle cores from sleeping, but it makes each wake-up an interrupt, which a
 * virtual machine delivers slowly; left alone, its kernel polls for a while before it sleeps.
 */
#ifndef DIPOLED_BENCH_SERVICE_CHILD_H
#define DIPOLED_BENCH_SERVICE_CHILD_H

#include <stdint.h>
#include <sys/types.h>

enum child_side {
  CHILD_ANYWHERE, /* every core that the benchmark was started on */
  CHILD_SERVER,
  CHILD_CLIENT,
};

/* Makes the temporary folder. A benchmark that has not ended after limit_s seconds is ended, with
 * all that it has started. */
void child_begin(unsigned limit_s);

/* Ends what is still running, removes the folder and unpins the calling process. Also called when
 * the process exits or is told to stop. */
void child_end_all(void);

/* The path of a file in the temporary folder, which is removed at the end; static. */
const char *child_path(const char *name);

/* Pins the calling process. */
void child_pin(enum child_side side);

/* As fork(). The child is pinned; it leaves with _exit(). */
pid_t child_fork(enum child_side side);

/* Runs a program, which is looked for in PATH if its name has no slash. Its output goes to the
 * file log. The environment is this process's without DIPOLED and DIPOLED_..., which would be
 * options. */
pid_t child_run(enum child_side side, char *const *arguments, const char *log);

/* Asks it to stop (SIGTERM), and makes it stop if it has not within seconds. */
void child_end(pid_t child);

/* Fails when the child has ended; name is for the message. */
void child_must_run(pid_t child, const char *name);

/* Processor time that it has taken so far. */
uint64_t child_cpu_ns(pid_t child);

#endif
