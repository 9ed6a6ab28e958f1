/* Code for wide registers. */
#ifndef CATHSIM_WIDE_H_
#define CATHSIM_WIDE_H_

/* Compiled for the wide registers of newer processors, too, and chosen when the library is loaded. Contraction is off,
 * so that both give the same bits. */
#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
#endif

#endif
