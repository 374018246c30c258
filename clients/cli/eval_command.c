/* dipole eval: profiles of a medium over a range of radii. */
#include "clients/cli/eval.h"

#include <stdlib.h>

#include "clients/cli/picture.h"
#include "clients/cli/plot.h"

static const cli_option radii_options[] = {
    CLI_OPTION(
        FILE, table, NULL,
        "evaluate the tables in a file of `dipole table`, without a daemon; -: standard input"),
    CLI_TITLE("Radii"),
    CLI_OPTION(NUMBERS, r, NULL, "these radii, mm; one may be inf"),
    CLI_EVAL_F_OPTION,
    CLI_OPTION(NUMBER, from, "0", "the first radius of a grid, mm"),
    CLI_OPTION(NUMBER, to, "10", "the last radius of the grid, mm"),
    CLI_OPTION(COUNT, count, "21", "how many radii the grid has"),
    CLI_OPTION(SWITCH, log, NULL,
               "make the ratios between radii equal instead of the steps; needs --from"),
    {0},
};

const cli_option cli_eval_options[] = {
    CLI_TITLE("Evaluation"),
    CLI_OPTION(
        NAMES, model, NULL,
        "`dipole info` lists them; all: every model that accepts the query, while standard error "
        "names "
        "those that refuse it (default: transport; with --tolerance the cheapest that is so near "
        "to "
        "it)"),
    CLI_MOMENTS_OPTION,
    CLI_EVALUATOR_OPTION,
    CLI_DEADLINE_OPTION,
    {0},
};

static const cli_option output_options[] = {
    CLI_OPTION(
        NAMES, wanted, NULL,
        "what to evaluate. R: 1/mm^2 per unit of power that entered; albedo; cdf: the share of the "
        "albedo within r; S: 1/(mm^2 sr); R_f: for striped light, at spatial frequencies in 1/mm; "
        "`dipole info` lists all (default: R,albedo; with --f R_f,albedo)"),
    CLI_OPTION(
        SWITCH, errors, NULL,
        "also write model_errors: how far the model is from transport at each radius. A medium for "
        "which transport has no stored solution is solved, which takes seconds"),
    CLI_TITLE("Output"),
    CLI_OPTION(FILES, plot, NULL,
               "also draw R over r into FILE.svg or FILE.png; -: as text below the table. May be "
               "repeated. "
               "`dipole plot` draws more"),
    {0},
};

/* A file of tables fixes the profile and needs no daemon, so this rejects options that concern
 * either. */
static int check_table(const cli_settings *settings) {
  if (cli_medium_given(settings) || settings->model.count > 0 || settings->moments != NULL ||
      settings->evaluator != NULL || cli_parameters_given(settings) ||
      settings->deadline_ms.given || settings->connect != NULL || settings->f.count > 0 ||
      settings->errors) {
    return cli_fail_usage("--table FILE says what is evaluated, and needs no daemon: of "
                          "the options leave all out but radii, --wanted and output");
  }
  return CLI_OK;
}

int cli_eval_check(cli_settings *settings) {
  if (settings->f.count > 0 && settings->r.count > 0) {
    return cli_fail_usage("--f is for R_f, and --r for all else: leave one out");
  }
  const bool at_f = settings->f.count > 0;
  const int status = settings->table != NULL ? check_table(settings) : cli_medium_check(settings);
  if (status != CLI_OK) {
    return status;
  }
  if ((at_f || settings->r.count > 0) &&
      (settings->from.given || settings->to.given || settings->count.given || settings->log)) {
    return cli_fail_usage("--%s gives the %s one by one: leave --from, --to, --count and --log out",
                          at_f ? "f" : "r", at_f ? "frequencies" : "radii");
  }
  if (settings->log && !settings->from.given) {
    return cli_fail_usage("--log needs --from, above 0");
  }
  return cli_picture_check(&settings->plot, settings);
}

static bool is_local(const cli_settings *settings) {
  return settings->table != NULL;
}

static int write_and_draw(const cli_settings *settings, const cli_eval_report *report) {
  if (settings->plot.count > 0 && (report->quantities.wanted & DIPOLE_R) == 0) {
    return cli_fail_usage("--plot draws R: add R to --wanted");
  }
  cli_eval_write(report, settings->form);
  return settings->plot.count > 0 ? cli_plot_R(report, &settings->plot) : CLI_OK;
}

static int run(const cli_settings *settings, dipole_client *client) {
  cli_eval_report report = {0};
  dipole_info *info = NULL;
  int status = is_local(settings) ? cli_eval_table(settings, &report, &info)
                                  : cli_eval_ask(settings, client, &report);
  if (status == CLI_OK) {
    status = write_and_draw(settings, &report);
  }
  free(info);
  return status;
}

const cli_command cli_command_eval = {
    .name = "eval",
    .about = "Evaluate a medium over a range of radii, as a table or a picture",
    .more =
        "The output has the values, their numerical error, the model's own error at these radii "
        "(against radiative transport, where that is solved), and notes on what the model does "
        "not do. A value is within the sum of both errors of transport. Some models are "
        "infinite at r = 0: tables and CSV then say inf, JSON \"inf\". NaN is an empty cell or "
        "null.\n"
        "With --tolerance and without --model, the daemon takes transport in the cheapest "
        "evaluator that keeps the tolerance for all channels and radii; the time to prepare a "
        "medium counts, so that few radii may get another one than many. With --model, "
        "--tolerance is a bound on the numerical error." CLI_DEFAULT_TEXT,
    .formats = "table,csv,json",
    .options = {cli_medium_options, radii_options, cli_eval_options, output_options},
    .parameters = CLI_OF_MODELS,
    .examples = "  dipole eval --medium skin1 --model classical,better --plot skin1.svg\n"
                "  dipole eval --sigma-a 0.01,0.1 --sigma-s 10 --g 0.9 --eta 1.4 --r 0,0.5,1,2\n"
                "  dipole eval --medium marble --from 0.01 --to 100 --count 41 --log --format csv\n"
                "  dipole eval --medium skin2 --eta 1 --moments fit --wanted albedo\n"
                "  dipole eval --medium skin1 --wanted S --cos-in 0.8 --cos-out 0.5 --r 0.5,1,2\n"
                "  dipole eval --medium skin1 --tolerance 0.01\n"
                "  dipole eval --sigma-a 0.05 --sigma-s 9.5 --g 0.9 --eta 1.4 --tolerance 0.01\n"
                "  dipole eval --medium skin1 --model better --evaluator f32 --wanted R,cdf\n"
                "  dipole eval --medium skin1 --model all --plot all.svg\n",
    .check = cli_eval_check,
    .is_local = is_local,
    .run = run,
};
