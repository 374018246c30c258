/* daemon: connecting, repeating requests to a busy daemon, and the names of what a daemon offers. */
#ifndef DIPOLE_CLI_DAEMON_H
#define DIPOLE_CLI_DAEMON_H

#include "clients/cli/cli.h"
#include "clients/cli/progress.h"

/* Connects to --connect, $DIPOLED or a private daemon. On failure, says why and returns NULL. */
dipole_client *cli_open(const cli_settings *settings);

/* Returns whether a call that failed is to be made again: the daemon was busy, and --retry-ms, or
 * else --timeout-ms, have not passed since start_ms. If so, waits first as long as the daemon requests
 * for, a second at most. */
bool cli_try_again(const cli_settings *settings, int64_t start_ms, const dipole_error *error);

/* Makes a call of libdipole, again and again while cli_try_again() says so. Its value is that of
 * the last call. Example:
 *   good = CLI_RETRY(settings, &error, dipole_eval(client, &query, &result, &error)); */
#define CLI_RETRY(settings, error, call)                                                           \
  __extension__({                                                                                  \
    const int64_t retry_start_ms = cli_now_ms();                                                   \
    bool retry_good;                                                                               \
    cli_progress_wait(true);                                                                       \
    do {                                                                                           \
      retry_good = (call);                                                                         \
    } while (!retry_good && cli_try_again((settings), retry_start_ms, (error)));                   \
    cli_progress_wait(false);                                                                      \
    retry_good;                                                                                    \
  })

/* Says what a call failed with and, if its field has one, by which option that is given: for
 * example "bad-value: radius_stop: allowed: 0 to 1e6 (--to)". Returns CLI_FAILED. */
int cli_fail_error(const dipole_error *error);
/* like cli_fail_error(), with "WHAT: " in front */
int cli_fail_error_of(const char *what, const dipole_error *error);

/* ---- names ----------------------------------------------------------------------------------- */

/* Returns the next choice of a kind from *from on, and sets *from behind it, or returns NULL. */
const dipole_choice *cli_next_choice(const dipole_info *info, enum dipole_kind kind, size_t *from);

/* Return the choice of a kind with this name or id; NULL if there is none. */
const dipole_choice *cli_choice(const dipole_info *info, enum dipole_kind kind, const char *name);
const dipole_choice *cli_choice_of_id(const dipole_info *info, enum dipole_kind kind, unsigned id);

/* Returns the choice with this name. If there is none, says which names there are, blames the
 * option, and returns NULL. */
const dipole_choice *cli_named(const dipole_info *info, enum dipole_kind kind, const char *option,
                               const char *name);

/* Writes all names of a kind, as "classical, better"; ", ..." is for those that do not fit. */
void cli_list_names(const dipole_info *info, enum dipole_kind kind, char *text, size_t bytes);

/* Returns a limit of the daemon by its name; `otherwise` if it has none of this name. */
uint64_t cli_limit(const dipole_info *info, const char *name, uint64_t otherwise);

/* Returns the next note in the sum `notes` from *from on; NULL if there is no more. */
const dipole_choice *cli_next_note(const dipole_info *info, unsigned notes, size_t *from);

#endif
