/* Fast marching: distance inside a lumen from seeds, second order in the spacing where two known nodes line up.
 *
 * Solves |grad T| = 1 with upwind differences, accepting nodes in the order of their distance (Sethian 1996). */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>

typedef struct {
  double value;
  int64_t node;
} Entry;

typedef struct {
  Entry* entries;
  int64_t count, capacity;
} Heap;

static int push(Heap* h, double value, int64_t node) {
  if (h->count == h->capacity) {
    int64_t capacity = h->capacity ? 2 * h->capacity : 4096;
    Entry* grown = realloc(h->entries, capacity * sizeof(Entry));
    if (!grown) return 0;
    h->entries = grown;
    h->capacity = capacity;
  }
  int64_t i = h->count++;
  while (i > 0 && h->entries[(i - 1) / 2].value > value) {
    h->entries[i] = h->entries[(i - 1) / 2];
    i = (i - 1) / 2;
  }
  h->entries[i] = (Entry){value, node};
  return 1;
}

static Entry pop(Heap* h) {
  Entry top = h->entries[0], last = h->entries[--h->count];
  int64_t i = 0;
  for (;;) {
    int64_t child = 2 * i + 1;
    if (child >= h->count) break;
    if (child + 1 < h->count && h->entries[child + 1].value < h->entries[child].value) child++;
    if (h->entries[child].value >= last.value) break;
    h->entries[i] = h->entries[child];
    i = child;
  }
  if (h->count > 0) h->entries[i] = last;
  return top;
}

/* The distance at a node from its accepted neighbours. Along each axis the upwind difference is a T - b, with a in
 * 1/spacing; the squares add up to 1. */
static double solve(const int size[3], const int64_t stride[3], double inverse, const uint8_t* accepted,
                    const double* distance, int64_t node, const int at[3]) {
  double a[3], b[3];
  int used = 0;
  for (int axis = 0; axis < 3; axis++) {
    double best = HUGE_VAL, second = HUGE_VAL;
    for (int side = -1; side <= 1; side += 2) {
      const int i = at[axis] + side;
      if (i < 0 || i >= size[axis] || !accepted[node + side * stride[axis]]) continue;
      const double near = distance[node + side * stride[axis]];
      if (near >= best) continue;
      best = near;
      second = HUGE_VAL;
      if (i + side >= 0 && i + side < size[axis] && accepted[node + 2 * side * stride[axis]]) {
        const double far = distance[node + 2 * side * stride[axis]];
        if (far <= near) second = far;
      }
    }
    if (best == HUGE_VAL) continue;
    a[used] = (second < HUGE_VAL ? 1.5 : 1.0) * inverse;
    b[used] = (second < HUGE_VAL ? 2.0 * best - 0.5 * second : best) * inverse;
    used++;
  }
  /* drop the axis with the largest upwind value until the solution lies above all of them */
  for (; used > 0; used--) {
    double aa = 0, ab = 0, bb = -1;
    int largest = 0;
    for (int k = 0; k < used; k++) {
      aa += a[k] * a[k];
      ab += a[k] * b[k];
      bb += b[k] * b[k];
      if (b[k] / a[k] > b[largest] / a[largest]) largest = k;
    }
    const double root = ab * ab - aa * bb;
    if (root >= 0) {
      const double value = (ab + sqrt(root)) / aa;
      if (used == 1 || value >= b[largest] / a[largest]) return value;
    }
    a[largest] = a[used - 1];
    b[largest] = b[used - 1];
  }
  return HUGE_VAL;
}

/* Marches from the nodes whose `distance` (m) is finite over those that are `inside`; both have size[0] x size[1] x
 * size[2] nodes, the last index contiguous. `accepted` is scratch of that size, zeroed. Returns 0, or 1 when memory is
 * short. */
int cathsim_march(const int size[3], double spacing, const uint8_t* inside, uint8_t* accepted, double* distance) {
  const int64_t stride[3] = {(int64_t)size[1] * size[2], size[2], 1};
  const int64_t total = size[0] * stride[0];
  Heap heap = {0};
  int failed = 0;
  for (int64_t node = 0; node < total && !failed; node++)
    if (inside[node] && isfinite(distance[node])) failed = !push(&heap, distance[node], node);
  while (heap.count > 0 && !failed) {
    const Entry top = pop(&heap);
    if (accepted[top.node] || top.value > distance[top.node]) continue;
    accepted[top.node] = 1;
    const int at[3] = {(int)(top.node / stride[0]), (int)(top.node / stride[1] % size[1]), (int)(top.node % size[2])};
    for (int axis = 0; axis < 3 && !failed; axis++) {
      for (int side = -1; side <= 1; side += 2) {
        const int i = at[axis] + side;
        const int64_t node = top.node + side * stride[axis];
        if (i < 0 || i >= size[axis] || !inside[node] || accepted[node]) continue;
        int place[3] = {at[0], at[1], at[2]};
        place[axis] = i;
        const double value = solve(size, stride, 1.0 / spacing, accepted, distance, node, place);
        if (value < distance[node]) {
          distance[node] = value;
          if (!push(&heap, value, node)) failed = 1;
        }
      }
    }
  }
  free(heap.entries);
  return failed;
}
