/* dipole sample: draws radii in proportion to the light that leaves there. */
#include <stdlib.h>
#include <string.h>

#include "clients/cli/daemon.h"
#include "clients/cli/eval.h"
#include "clients/cli/options.h"
#include "clients/cli/progress.h"

#define DRAW_OF_A_LIST "list"

static const cli_option options[] = {
    CLI_TITLE("Numbers"),
    CLI_OPTION(NUMBERS, u, NULL,
               "take these numbers, from 0 (which gives 0 mm) to 1 (which gives inf)"),
    CLI_OPTION(COUNT, count, "10", "how many numbers are drawn"),
    CLI_OPTION(TEXT, draw, NULL,
               "how to draw them. random; stratified: one in each of N equal intervals; regular: "
               "the middles of the intervals (default: random)"),
    CLI_OPTION(COUNT, seed, "1", "for random and stratified; the same seed gives the same bits"),
    CLI_OPTION(COUNT, first, NULL, "for random: start with number N of the seed (default: 0)"),
    CLI_TITLE("Evaluation"),
    CLI_OPTION(NAME, model, CLI_MODEL_DEFAULT, "a model that covers all radii; see `dipole info`"),
    CLI_MOMENTS_OPTION,
    CLI_EVALUATOR_OPTION,
    CLI_OPTION(
        NAMES, wanted, NULL,
        "what to write. r: the radii; pdf: their density, 1/mm, which is 2 pi r times that of "
        "points on the surface; `dipole info` lists all, at these radii (default: r,pdf)"),
    CLI_DEADLINE_OPTION,
    {0},
};

static int check(cli_settings *settings) {
  if (settings->u.count > 0 && (settings->count.given || settings->draw != NULL ||
                                settings->seed.given || settings->first.given)) {
    return cli_fail_usage(
        "--u gives the numbers one by one: leave --count, --draw, --seed and --first out");
  }
  if (settings->evaluator == NULL) {
    settings->evaluator = cli_usual_evaluator(settings, settings->model.items[0]);
  }
  return cli_medium_check(settings);
}

/* ---- asking ---------------------------------------------------------------------------------- */

/* Looks up the names of the draw and the quantities. */
static int choose(const cli_settings *settings, cli_eval_report *report) {
  const char *draw = settings->draw != NULL ? settings->draw : "random";
  report->place = "u";
  report->draw = cli_named(report->profile.info, DIPOLE_DRAW, "draw",
                           settings->u.count > 0 ? DRAW_OF_A_LIST : draw);
  if (report->draw == NULL) {
    return CLI_USAGE;
  }
  if (settings->u.count == 0 && report->draw->id == DIPOLE_DRAW_LIST) {
    return cli_fail_usage("--draw %s: give the numbers with --u", DRAW_OF_A_LIST);
  }
  return cli_quantities_take(report->profile.info, &settings->wanted, DIPOLE_RADIUS | DIPOLE_PDF, 0,
                             &report->quantities)
             ? CLI_OK
             : CLI_USAGE;
}

static dipole_sample_query make_query(const cli_settings *settings, const cli_eval_report *report) {
  const cli_profile *profile = &report->profile;
  const unsigned draw = report->draw->id;
  const bool seeded = draw == DIPOLE_DRAW_RANDOM || draw == DIPOLE_DRAW_STRATIFIED;
  return (dipole_sample_query){
      .model = profile->model->id,
      .evaluator = profile->evaluator->id,
      .moments = profile->moments->id,
      .wanted = report->quantities.wanted | DIPOLE_MODEL_ERROR,
      .media = profile->media,
      .medium_count = (uint32_t)profile->channel_count,
      .draw = draw,
      .sample_count = settings->u.count > 0 ? settings->u.count : settings->count.value,
      .sample_first = settings->first.value,
      /* A seed that has no use is sent if it was given, so that the daemon refuses it. */
      .seed = seeded || settings->seed.given ? settings->seed.value : 0,
      .parameters = profile->parameters.items,
      .parameter_count = profile->parameters.count,
      .deadline_ms = (unsigned)settings->deadline_ms.value,
  };
}

/* Random numbers are requested in pieces, which shows how far the work is. */
enum { PIECE_SAMPLES = 1 << 16 };

static bool ask_pieces(const cli_settings *settings, dipole_client *client,
                       const dipole_sample_query *query, cli_eval_report *report,
                       dipole_error *error) {
  const uint64_t count = query->sample_count;
  const bool cut = query->draw == DIPOLE_DRAW_RANDOM && count > PIECE_SAMPLES;
  cli_progress progress;
  uint64_t first = 0;
  bool good;
  cli_progress_start(&progress, "radii");
  do {
    dipole_sample_query piece = *query;
    dipole_result *result;
    piece.sample_first += first;
    piece.sample_count = cut && count - first > PIECE_SAMPLES ? PIECE_SAMPLES : count - first;
    good = CLI_ASK(settings, error, dipole_sample(client, &piece, &result, error));
    if (good) {
      report->place_count = (size_t)count;
      cli_eval_keep(report, 0, (size_t)first, result);
      dipole_result_free(result);
    }
    first += piece.sample_count;
    cli_progress_show(&progress, (double)first / (double)count, (double)first);
  } while (good && first < count);
  cli_progress_wipe(&progress);
  return good;
}

static int ask(const cli_settings *settings, dipole_client *client, cli_eval_report *report) {
  const bool single = report->profile.evaluator->id != DIPOLE_F64;
  dipole_sample_query query = make_query(settings, report);
  dipole_error error;
  report->seed = query.seed;
  report->first = query.sample_first;
  query.numbers = settings->u.count > 0 ? cli_numbers_in(&settings->u, single) : NULL;
  if (!ask_pieces(settings, client, &query, report, &error)) {
    return cli_fail_error(&error);
  }
  const void *u = query.numbers;
  if (u == NULL) {
    void *drawn = cli_allocate(report->place_count, sizeof(double));
    if (!dipole_sample_numbers(&query, 0, report->place_count, drawn, &error)) {
      return cli_fail_error(&error);
    }
    u = drawn;
  }
  report->places = cli_allocate(report->place_count, sizeof *report->places);
  for (size_t i = 0; i < report->place_count; i++) {
    report->places[i] =
        single ? cli_number_of_single(((const float *)u)[i]) : ((const double *)u)[i];
  }
  return CLI_OK;
}

/* ---- the command ----------------------------------------------------------------------------- */

static int run(const cli_settings *settings, dipole_client *client) {
  cli_eval_report report = {0};
  int status = cli_profile_take(settings, client, &report.profile);
  status = status == CLI_OK ? choose(settings, &report) : status;
  if (status == CLI_OK) {
    cli_eval_add_model(&report, report.profile.model, true);
    report.models[0].evaluator = report.profile.evaluator;
    cli_eval_make_values(&report);
    status = ask(settings, client, &report);
  }
  if (status == CLI_OK) {
    cli_eval_write(&report, settings->form);
  }
  return status;
}

const cli_command cli_command_sample = {
    .name = "sample",
    .about = "Draw radii in proportion to the light that leaves there",
    .more = "Each number u gives the radius within which the share u of the light leaves. So "
            "uniform numbers give radii in proportion to r R(r). All channels get the same "
            "numbers." CLI_DEFAULT_TEXT,
    .formats = "table,csv,json",
    .options = {cli_medium_options, options},
    .parameters = CLI_OF_MODELS,
    .check = check,
    .run = run,
    .examples = "  dipole sample --medium skin1\n"
                "  dipole sample --medium skin1 --u 0.1,0.5,0.9 --wanted r,pdf,R,cdf\n"
                "  dipole sample --sigma-a 0.01 --sigma-s 1 --count 1000 --draw stratified "
                "--seed 7 --format csv\n"
                "  dipole sample --medium marble --model burley --count 10000\n"
                "  dipole sample --medium skin1 --model better --evaluator f32 --count 1000\n",
};
