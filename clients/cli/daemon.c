#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "clients/cli/cli.h"

void cli_connection_options(const cli_common *common, dipole_options *options) {
  dipole_options_init(options);
  options->timeout_ms = (unsigned)common->timeout_ms.value;
  if (common->timeout_ms.given) {
    options->connect_timeout_ms = options->timeout_ms;
  }
  if (common->retry_ms.given) {
    options->open_ms = options->retry_ms = (unsigned)common->retry_ms.value;
  }
}

bool cli_open(const cli_command *command, const cli_common *common, dipole_client **client) {
  dipole_options options;
  dipole_error error;
  cli_connection_options(common, &options);
  if (dipole_open_with(common->connect, &options, client, &error)) {
    if (common->retry_ms.given) { /* also of private: */
      dipole_set_retry_ms(*client, (unsigned)common->retry_ms.value);
    }
    return true;
  }
  cli_fail(command, "%s", error.text);
  const char *address = common->connect != NULL ? common->connect : getenv("DIPOLED");
  if (error.kind == DIPOLE_ERROR_CONNECT && address != NULL &&
      strncmp(address, "private:", strlen("private:")) != 0) {
    fputs("Start a daemon there (dipoled --listen ADDRESS), or have a private one: no --connect, no "
          "$DIPOLED.\n",
          stderr);
  }
  return false;
}

int64_t cli_now_ms(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

void cli_nap(const dipole_error *busy) {
  const uint32_t nap_ms = busy->retry_after_ms < 1000 ? busy->retry_after_ms : 1000;
  const struct timespec nap = {.tv_sec = nap_ms / 1000, .tv_nsec = (nap_ms % 1000) * 1000000L};
  nanosleep(&nap, NULL);
}

bool cli_is_patient(const cli_common *common, int64_t start_ms) {
  const int64_t busy_ms = cli_now_ms() - start_ms;
  return common->retry_ms.given
             ? busy_ms < (int64_t)common->retry_ms.value
             : common->timeout_ms.value == 0 || busy_ms < (int64_t)common->timeout_ms.value;
}

/* After an error of a call that began at start_ms: whether it is to be made again, when the nap
 * that the daemon asked for is over. */
static bool nap_while_busy(const cli_common *common, int64_t start_ms, const dipole_error *error) {
  if (error->retry_after_ms == 0 || !cli_is_patient(common, start_ms)) {
    return false;
  }
  cli_nap(error);
  return true;
}

bool cli_eval_parts(dipole_client *client, const cli_common *common, const dipole_query *query,
                    bool (*part)(void *context, const dipole_result *part, uint64_t radius_first),
                    void *context, dipole_error *error) {
  const int64_t start_ms = cli_now_ms();
  while (!dipole_eval_parts(client, query, part, context, error)) {
    if (!nap_while_busy(common, start_ms, error)) {
      return false;
    }
  }
  return true;
}

bool cli_offers(dipole_client *client, const cli_common *common, const dipole_query *query,
                dipole_offer **offers, size_t *count, size_t *taken, dipole_error *error) {
  const int64_t start_ms = cli_now_ms();
  while (!dipole_offers(client, query, offers, count, taken, error)) {
    if (!nap_while_busy(common, start_ms, error)) {
      return false;
    }
  }
  return true;
}

bool cli_table_fetch(dipole_client *client, const cli_common *common,
                     const dipole_table_query *query, dipole_table **table, dipole_error *error) {
  const int64_t start_ms = cli_now_ms();
  while (!dipole_table_fetch(client, query, table, error)) {
    if (!nap_while_busy(common, start_ms, error)) {
      return false;
    }
  }
  return true;
}

bool cli_sample(dipole_client *client, const cli_common *common, const dipole_sample_query *query,
                dipole_result **result, dipole_error *error) {
  const int64_t start_ms = cli_now_ms();
  while (!dipole_sample(client, query, result, error)) {
    if (!nap_while_busy(common, start_ms, error)) {
      return false;
    }
  }
  return true;
}

bool cli_invert(dipole_client *client, const cli_common *common, const dipole_invert_query *query,
                dipole_inversion **inversion, dipole_error *error) {
  const int64_t start_ms = cli_now_ms();
  while (!dipole_invert(client, query, inversion, error)) {
    if (!nap_while_busy(common, start_ms, error)) {
      return false;
    }
  }
  return true;
}

int cli_run_plain(const cli_command *command, int argc, char **argv,
                  int (*show)(const cli_command *command, const char *format,
                              dipole_client *client)) {
  cli_common common = {0};
  dipole_client *client;
  const char *operand;
  int status;
  if (!cli_options_read(command, argc, argv, &common, &operand, &status)) {
    return status;
  }
  if (!cli_open(command, &common, &client)) {
    return CLI_FAILED;
  }
  status = show(command, common.format, client);
  dipole_close(client);
  return status;
}
