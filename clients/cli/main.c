/* dipole: the command line of dipoled. Each command has its own file. */
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include "clients/cli/daemon.h"
#include "clients/cli/options.h"
#include "proto/standard.h"

/* The commands, in the order of help. */
#define COMMANDS(EACH)                                                                             \
  EACH(eval), EACH(plot), EACH(points), EACH(sample), EACH(invert), EACH(fit), EACH(texture),      \
      EACH(convert), EACH(bake), EACH(gather), EACH(table), EACH(mc), EACH(tissue), EACH(media),   \
      EACH(info), EACH(bench)
#define COMMAND(name) cli_command_##name
#define AT(name) &cli_command_##name
extern const cli_command COMMANDS(COMMAND);
const cli_command *const cli_commands[] = {COMMANDS(AT), NULL};

static void print_help(FILE *file) {
  fputs(
      "Usage: dipole COMMAND [OPTION]...\n\n"
      "Queries the daemon dipoled: how much light leaves a translucent medium at distance r from\n"
      "where it entered: R(r) in 1/mm^2 per unit of power that entered. Unless --connect\n"
      "or the environment variable DIPOLED names a daemon, it starts a private one.\n\nCommands\n",
      file);
  for (size_t i = 0; cli_commands[i] != NULL; i++) {
    fprintf(file, "  %-8s %s\n", cli_commands[i]->name, cli_commands[i]->about);
  }
  fputs("  help     This text, or `dipole help COMMAND`\n\n"
        "`dipole COMMAND --help` describes a command; `dipole --version` prints the version.\n",
        file);
}

static const cli_command *find_command(const char *name) {
  for (size_t i = 0; cli_commands[i] != NULL; i++) {
    if (strcmp(cli_commands[i]->name, name) == 0) {
      return cli_commands[i];
    }
  }
  return NULL;
}

static int fail_unknown(const char *name) {
  fprintf(stderr, "dipole: there is no command '%s'; the commands are", name);
  for (size_t i = 0; cli_commands[i] != NULL; i++) {
    fprintf(stderr, " %s,", cli_commands[i]->name);
  }
  fputs(" help\n", stderr);
  return CLI_USAGE;
}

static int help(const char *name) {
  const cli_command *command = name != NULL ? find_command(name) : NULL;
  if (name != NULL && command == NULL) {
    return fail_unknown(name);
  }
  if (command != NULL) {
    cli_options_help(command);
  } else {
    print_help(stdout);
  }
  return CLI_OK;
}

#define SERVICE "/run/dipoled.sock" /* as server/dipoled.socket has it */

/* Names the installed service if no daemon is named and the service is there, and says so. */
static void find_service(cli_settings *settings) {
  const struct sockaddr_un at = {.sun_family = AF_UNIX, .sun_path = SERVICE};
  const char *named = getenv("DIPOLED");
  if (settings->connect != NULL || (named != NULL && named[0] != '\0')) {
    return;
  }
  const int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (fd >= 0 && connect(fd, (const struct sockaddr *)&at, sizeof at) == 0) {
    settings->connect = "unix:" SERVICE;
    settings->is_service = true;
    cli_say(CLI_OK, "this is the installed service, unix:" SERVICE "; --connect names others");
  } else if (errno == EACCES) {
    cli_say(CLI_OK, "this is a private daemon, since you may not connect to the installed service; "
                    "`adduser USER dipole` allows it");
  }
  if (fd >= 0) {
    close(fd);
  }
}

static int connect_and_run(const cli_command *command, cli_settings *settings) {
  if (command->shows_service) {
    find_service(settings);
  }
  const bool local = command->is_local != NULL && command->is_local(settings);
  dipole_client *client = local ? NULL : cli_open(settings);
  const int status = local || client != NULL ? command->run(settings, client) : CLI_FAILED;
  if (client != NULL) {
    dipole_close(client);
  }
  return status;
}

static int run_command(const cli_command *command, int argc, char **argv) {
  cli_settings *settings = cli_allocate(1, sizeof *settings);
  int status;
  cli_start(command);
  if (cli_options_read(argc, argv, settings, &status)) {
    status = command->check != NULL ? command->check(settings) : CLI_OK;
    if (status == CLI_OK) {
      status = connect_and_run(command, settings);
    }
  }
  return status;
}

static int run_arguments(int argc, char **argv) {
  if (argc == 3 && strcmp(argv[1], "complete") == 0) { /* for shells, and not in any help */
    return cli_complete(argv[2]);
  }
  if (argc < 2) {
    print_help(stderr);
    return CLI_USAGE;
  }
  if (strcmp(argv[1], "--version") == 0) {
    puts("dipole " DIPOLED_VERSION);
    return CLI_OK;
  }
  if (strcmp(argv[1], "help") == 0 || strcmp(argv[1], "--help") == 0) {
    return help(argc > 2 && strcmp(argv[2], "--help") != 0 ? argv[2] : NULL);
  }
  const cli_command *command = find_command(argv[1]);
  return command != NULL ? run_command(command, argc - 1, argv + 1) : fail_unknown(argv[1]);
}

int main(int argc, char **argv) {
  if (!standard_open()) {
    perror("dipole: /dev/null");
    return CLI_FAILED;
  }
  const int status = run_arguments(argc, argv);
  cli_free_all();
  return standard_flush("dipole") ? status : CLI_FAILED;
}
