/* A* over numbered nodes of a lattice with 26 neighbours. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "lattice.h"

enum { MOVES = 26 };

typedef struct {
  double estimate; /* of the whole way through the node */
  int32_t node;
} Entry;

typedef struct {
  Entry* entries;
  int64_t count, capacity;
} Heap;

/* Among equal estimates the lower number goes first: the way found does not depend on the heap. */
static int before(Entry a, Entry b) { return a.estimate < b.estimate || (a.estimate == b.estimate && a.node < b.node); }

static int push(Heap* h, Entry entry) {
  if (h->count == h->capacity) {
    const int64_t capacity = h->capacity ? 2 * h->capacity : 4096;
    Entry* grown = realloc(h->entries, capacity * sizeof(Entry));
    if (!grown) return 0;
    h->entries = grown;
    h->capacity = capacity;
  }
  int64_t i = h->count++;
  while (i > 0 && before(entry, h->entries[(i - 1) / 2])) {
    h->entries[i] = h->entries[(i - 1) / 2];
    i = (i - 1) / 2;
  }
  h->entries[i] = entry;
  return 1;
}

static Entry pop(Heap* h) {
  const Entry top = h->entries[0], last = h->entries[--h->count];
  int64_t i = 0;
  for (;;) {
    int64_t child = 2 * i + 1;
    if (child >= h->count) break;
    if (child + 1 < h->count && before(h->entries[child + 1], h->entries[child])) child++;
    if (!before(h->entries[child], last)) break;
    h->entries[i] = h->entries[child];
    i = child;
  }
  if (h->count > 0) h->entries[i] = last;
  return top;
}

/* Cheapest way from node `begin` to `goal`.
 *
 * A move to a neighbour, a step of `steps` that is `lengths` long, costs its length times the sum of `half` at both
 * ends; `bound` is a lower bound of the cost from each node to the goal. Fills `from` with the node before each on the
 * way, -1 where there is none. Returns 0 where it found the goal, 1 where no way leads there, 2 when memory is short. */
int cathsim_shortest_path(const NodeSet* set, const int32_t steps[MOVES], const double lengths[MOVES],
                          const double* half, const double* bound, int32_t begin, int32_t goal, int32_t* from) {
  const int32_t count = set->count;
  double* best = malloc(count * sizeof(double));
  uint8_t* closed = calloc(count, 1);
  Heap heap = {0};
  int result = best && closed && push(&heap, (Entry){bound[begin], begin}) ? 1 : 2;
  if (result == 1) {
    for (int32_t node = 0; node < count; node++) {
      best[node] = HUGE_VAL;
      from[node] = -1;
    }
    best[begin] = 0;
  }
  while (result == 1 && heap.count > 0) {
    const int32_t here = pop(&heap).node;
    if (closed[here]) continue;
    closed[here] = 1;
    if (here == goal) {
      result = 0;
      break;
    }
    for (int move = 0; move < MOVES; move++) {
      const int32_t there = node_neighbour(set, here, steps[move]);
      if (there < 0 || closed[there]) continue;
      const double cost = best[here] + lengths[move] * (half[here] + half[there]);
      if (cost < best[there]) {
        best[there] = cost;
        from[there] = here;
        if (!push(&heap, (Entry){cost + bound[there], there})) {
          result = 2;
          break;
        }
      }
    }
  }
  free(best);
  free(closed);
  free(heap.entries);
  return result;
}
