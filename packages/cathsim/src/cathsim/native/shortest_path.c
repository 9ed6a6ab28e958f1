/* A* over numbered nodes of a lattice with 26 neighbours. */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

#include "lattice.h"

enum { MOVES = 26 };

/* The value is an estimate of the whole way through the node. Among equal ones the lower number goes first: the way
 * found does not depend on the heap. */
#define BEFORE(a, b) ((a).value < (b).value || ((a).value == (b).value && (a).node < (b).node))
#include "heap.h"

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
