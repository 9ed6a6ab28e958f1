/* A binary heap of nodes by a value. Include it once, after `BEFORE(a, b)`: whether entry a leaves the heap before b. */
#ifndef CATHSIM_HEAP_H_
#define CATHSIM_HEAP_H_

#include <stdint.h>
#include <stdlib.h>

typedef struct {
  double value;
  int32_t node;
} Entry;

typedef struct {
  Entry* entries;
  int64_t count, capacity;
} Heap;

/* Returns 0 when memory is short. */
static int push(Heap* h, Entry entry) {
  if (h->count == h->capacity) {
    const int64_t capacity = h->capacity ? 2 * h->capacity : 4096;
    Entry* grown = realloc(h->entries, capacity * sizeof(Entry));
    if (!grown) return 0;
    h->entries = grown;
    h->capacity = capacity;
  }
  int64_t i = h->count++;
  while (i > 0 && BEFORE(entry, h->entries[(i - 1) / 2])) {
    h->entries[i] = h->entries[(i - 1) / 2];
    i = (i - 1) / 2;
  }
  h->entries[i] = entry;
  return 1;
}

/* The heap must not be empty. */
static Entry pop(Heap* h) {
  const Entry top = h->entries[0], last = h->entries[--h->count];
  int64_t i = 0;
  for (;;) {
    int64_t child = 2 * i + 1;
    if (child >= h->count) break;
    if (child + 1 < h->count && BEFORE(h->entries[child + 1], h->entries[child])) child++;
    if (!BEFORE(h->entries[child], last)) break;
    h->entries[i] = h->entries[child];
    i = child;
  }
  if (h->count > 0) h->entries[i] = last;
  return top;
}

#endif
