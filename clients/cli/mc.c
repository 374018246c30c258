/* dipole mc: a Monte Carlo job on the daemon, followed until its table is there. */
#include "clients/cli/mc.h"

#include <signal.h>
#include <string.h>

#define FIELD(name) offsetof(cli_mc_settings, name)

static const cli_option options[] = {
    {"Medium", NULL, NULL, CLI_HEADING, 0},
    {"medium", "NAME", "a measured medium, see `dipole media`; one channel of it", CLI_TEXT,
     FIELD(medium)},
    {"channel", "COLOUR", "red, green or blue", CLI_TEXT, FIELD(channel)},
    {"sigma-a", "X", "absorption coefficient, 1/mm", CLI_NUMBER, FIELD(sigma_a)},
    {"sigma-s", "X", "scattering coefficient, 1/mm", CLI_NUMBER, FIELD(sigma_s)},
    {"g", "X",
     "mean cosine of the scattering angle (default: 0); of a measured medium\n"
     "sigma_s (1 - g) stays what was measured",
     CLI_NUMBER, FIELD(g)},
    {"eta", "X", "refractive index inside over outside (default: the measured\nmedium's, else 1.3)",
     CLI_NUMBER, FIELD(eta)},
    {"thickness", "X", "of a slab, mm (default: half space)", CLI_NUMBER, FIELD(thickness)},
    {"albedo", "X[,X...]",
     "single-scattering albedos in place of the medium's own, up to 16;\none walk serves all",
     CLI_NUMBERS, FIELD(albedo)},
    {"Rings", NULL, NULL, CLI_HEADING, 0},
    {"from", "X", "inner edge of the first ring, mm (default: 0)", CLI_NUMBER, FIELD(from)},
    {"to", "X", "outer edge of the last ring, mm (default: 10)", CLI_NUMBER, FIELD(to)},
    {"rings", "N", "how many there are (default: 20)", CLI_COUNT, FIELD(rings)},
    {"log", NULL, "equal ratios from edge to edge instead of equal steps; needs --from", CLI_SWITCH,
     FIELD(logarithmic)},
    {"Effort", NULL, NULL, CLI_HEADING, 0},
    {"photons", "N",
     "to walk, such as 2e6 (default: 1e6; with an error, as many as the\ndaemon allows)",
     CLI_NUMBER, FIELD(photons)},
    {"error", "X", "end when each ring with light has this relative standard error", CLI_NUMBER,
     FIELD(error)},
    {"total-error", "X", "end when the total R has it; with --error, when both hold", CLI_NUMBER,
     FIELD(total_error)},
    {"seed", "N", "of the random numbers: the same seed gives the same bits (default: 1)",
     CLI_COUNT, FIELD(seed)},
    {0},
};

static const struct {
  const char *name;
  void (*write)(const cli_mc_report *report, FILE *file);
} formats[] = {
    {"table", cli_mc_write_table},
    {"csv", cli_mc_write_csv},
    {"json", cli_mc_write_json},
};

/* ---- following ----------------------------------------------------------------------------- */

static volatile sig_atomic_t interrupted;

static void on_interrupt(int signal_number) {
  (void)signal_number;
  interrupted = 1;
}

/* The first Ctrl-C cancels the job, a second one ends the program. */
static void catch_interrupt(void) {
  struct sigaction action = {.sa_handler = on_interrupt, .sa_flags = SA_RESETHAND | SA_RESTART};
  sigemptyset(&action.sa_mask);
  sigaction(SIGINT, &action, NULL);
}

static bool follow(void *context, const dipole_mc_progress *now) {
  cli_mc_progress(context, now);
  return interrupted == 0;
}

/* dipole_mc(), asked again for as long as the daemon is busy, within bounds. */
static bool run_job(dipole_client *client, const cli_common *common, const dipole_mc_query *query,
                    dipole_mc_result **result, dipole_error *error) {
  const int64_t start_ms = cli_now_ms();
  cli_progress progress;
  cli_progress_start(&progress, "photons");
  while (!dipole_mc(client, query, follow, &progress, result, error)) {
    if (error->retry_after_ms == 0 || !cli_is_patient(common, start_ms) || interrupted != 0) {
      cli_progress_wipe(&progress);
      return false;
    }
    cli_nap(error);
  }
  cli_progress_wipe(&progress);
  return true;
}

/* ---- the command --------------------------------------------------------------------------- */

/* What a person wrote to give a field of the request its value: " (--from)". */
static const char *option_of(const cli_command *command, const char *field, char *text,
                             size_t bytes) {
  static const struct {
    const char *field, *option;
  } others[] = {{"radius_start", "from"},       {"radius_stop", "to"},
                {"ring_count", "rings"},        {"error_rings", "error"},
                {"error_total", "total-error"}, {"albedo_count", "albedo"}};
  for (size_t i = 0; i < sizeof others / sizeof others[0]; i++) {
    if (strcmp(others[i].field, field) == 0) {
      field = others[i].option;
    }
  }
  const cli_option *option = cli_options_find(command, field);
  text[0] = '\0';
  if (option != NULL) {
    snprintf(text, bytes, " (--%s)", option->name);
  }
  return text;
}

/* The table is written in any case; whoever asked for more is told. */
static int judge(const cli_command *command, const cli_mc_report *report) {
  const dipole_mc_query *query = &report->query;
  const unsigned long long photons = report->result->last.photons;
  if (report->result->end == DIPOLE_MC_CANCELLED) {
    return cli_fail(command, "cancelled after %llu of %llu photons", photons,
                    (unsigned long long)query->photons);
  }
  if (report->result->end == DIPOLE_MC_STOPPED) {
    return cli_fail(command, "the daemon stopped after %llu of %llu photons", photons,
                    (unsigned long long)query->photons);
  }
  if (report->result->end == DIPOLE_MC_PHOTONS &&
      (query->error_rings > 0 || query->error_total > 0)) {
    return cli_fail(command,
                    "%llu photons were not enough for the error asked for: the worst ring has "
                    "%.2g, R has %.2g",
                    photons, report->result->last.error_rings, report->result->last.error_total);
  }
  return CLI_OK;
}

static int ask_and_write(const cli_command *command, const cli_mc_settings *settings,
                         dipole_client *client) {
  cli_mc_report report = {0};
  dipole_mc_result *result;
  dipole_error error;
  char option[64];
  const int status = cli_mc_query(command, settings, client, &report);
  if (status != CLI_OK) {
    return status;
  }
  catch_interrupt();
  if (!run_job(client, &settings->common, &report.query, &result, &error)) {
    return cli_fail(command, "%s%s", error.text,
                    option_of(command, error.field, option, sizeof option));
  }
  report.result = result;
  const char *format = settings->common.format != NULL ? settings->common.format : formats[0].name;
  for (size_t i = 0; i < sizeof formats / sizeof formats[0]; i++) {
    if (strcmp(formats[i].name, format) == 0) {
      formats[i].write(&report, stdout);
    }
  }
  const int judged = judge(command, &report);
  dipole_mc_result_free(result);
  return judged;
}

static int run(const cli_command *command, int argc, char **argv) {
  cli_mc_settings settings = {0};
  dipole_client *client;
  const char *operand;
  int status;
  if (cli_options_read(command, argc, argv, &settings, &operand, &status)) {
    status = cli_mc_check(command, &settings);
    if (status == CLI_OK && !cli_open(command, &settings.common, &client)) {
      status = CLI_FAILED;
    } else if (status == CLI_OK) {
      status = ask_and_write(command, &settings, client);
      dipole_close(client);
    }
  }
  cli_options_free(command, &settings);
  return status;
}

const cli_command cli_command_mc = {
    .name = "mc",
    .about = "Walk photons through a medium (Monte Carlo): R(r) with standard errors",
    .more =
        "\n"
        "A job on the daemon, at low priority beside its other work. Ctrl-C cancels it and\n"
        "prints what there is. Values are means over rings, in 1/mm^2 per unit of power that\n"
        "entered; overflow beyond the last ring, the total R and T and what was absorbed stand\n"
        "apart. The exit status is 1 when it was cancelled or missed the error asked for.\n",
    .formats = "table,csv,json",
    .options = options,
    .examples = "  dipole mc --medium skin1 --channel red\n"
                "  dipole mc --medium skin1 --channel blue --g 0.8 --error 0.02 --to 3\n"
                "  dipole mc --sigma-a 0.01 --sigma-s 10 --g 0.9 --eta 1.4 --thickness 2\n"
                "  dipole mc --sigma-a 0.1 --sigma-s 1 --albedo 0.5,0.9,0.99 --from 0.01 --log\n",
    .run = run,
};
