#include "server/observe/latency.h"

#include <uv.h>

void latency_finish(struct latency *latency) {
  if (latency->group_count == 0) {
    return;
  }
  const uint64_t now_ns = uv_hrtime();
  for (unsigned i = 0; i < latency->group_count; i++) {
    const struct latency_group *group = &latency->groups[i];
    for (unsigned kind = 0; kind < LATENCY_CLASSES; kind++) {
      if (group->counts[kind] > 0) {
        histogram_add(&latency->histograms[kind], now_ns - group->arrived_ns, group->counts[kind]);
      }
    }
  }
  latency->group_count = 0;
}

void latency_note(struct latency *latency, enum latency_class kind, uint64_t arrived_ns) {
  for (unsigned i = 0; i < latency->group_count; i++) {
    if (latency->groups[i].arrived_ns == arrived_ns) {
      latency->groups[i].counts[kind]++;
      return;
    }
  }
  if (latency->group_count == LATENCY_GROUPS) { /* those are about to be handed over */
    latency_finish(latency);
  }
  struct latency_group *group = &latency->groups[latency->group_count++];
  *group = (struct latency_group){.arrived_ns = arrived_ns};
  group->counts[kind] = 1;
}
