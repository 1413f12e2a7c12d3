/* Access to the words of spec/shm-format.md.
 *
 *   0  rosplc_identity (2 lines)   constant once visible, except `state`
 * 128  rosplc_writer_line          stored by the writer only
 * 192  rosplc_reader_line x 4      each stored by its claimant only
 * 448  reserved line
 * 512  self-description, then the slots: rosplc_slot_header + record each
 *
 * Every word is loaded and stored with rosplc_load/rosplc_store: one relaxed 32-bit access (section 1, rule 2).
 * Order comes from the explicit fences of section 7, never from the accesses.
 */
#ifndef ROSPLC_FORMAT_H
#define ROSPLC_FORMAT_H

#include <string.h>

#include "numbers.h"

#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "the format is little-endian (section 1, rule 1)"
#endif

static inline uint32_t rosplc_load(const uint32_t *word)
{
    return __atomic_load_n(word, __ATOMIC_RELAXED);
}

static inline void rosplc_store(uint32_t *word, uint32_t value)
{
    __atomic_store_n(word, value, __ATOMIC_RELAXED);
}

static inline int rosplc_compare_and_swap(uint32_t *word, uint32_t expected, uint32_t desired)
{
    return __atomic_compare_exchange_n(word, &expected, desired, 0, __ATOMIC_SEQ_CST, __ATOMIC_RELAXED);
}

/* Hints: to prefetch the line at `line` for writing, and to compute with `value` as if it were unknown. GCC's builtin
 * prefetches for writing only if the target is known to have PREFETCHW; every x86-64 has it, or executes it as a
 * no-op. A model checker defines ROSPLC_PLAIN, which avoids assembler. */
#if defined(ROSPLC_PLAIN)
#define rosplc_prefetch_for_writing(line) ((void)(line))
#define ROSPLC_OPAQUE(value) ((void)0)
#else
static inline void rosplc_prefetch_for_writing(const void *line)
{
#if defined(__x86_64__)
    __asm__ volatile("prefetchw %0" : : "m"(*(const char *)line));
#else
    __builtin_prefetch(line, 1);
#endif
}
#define ROSPLC_OPAQUE(value) __asm__("" : "+r"(value))
#endif

static inline void rosplc_fence_acquire(void)
{
    __atomic_thread_fence(__ATOMIC_ACQUIRE);
}

/* A release fence that also orders the stores of a copy of `size` bytes. On x86 plain stores need no instruction,
 * but a C library copies large blocks with non-temporal stores, which no plain store orders: they might overtake
 * the previous store to `head`. The library selects them at run time, so code compiled for a processor without SSE
 * needs this order as well; there, a locked instruction provides it. */
static inline void rosplc_fence_release(uint32_t size)
{
#if defined(ROSPLC_PLAIN) || !(defined(__x86_64__) || defined(__i386__))
    (void)size;
#elif defined(__SSE__)
    if (size >= 16384u)
        __builtin_ia32_sfence();
#else
    if (size >= 16384u)
        __atomic_thread_fence(__ATOMIC_SEQ_CST);
#endif
    __atomic_thread_fence(__ATOMIC_RELEASE);
}

/* Also orders earlier stores before later loads (M26). */
static inline void rosplc_fence_full(void)
{
    __atomic_thread_fence(__ATOMIC_SEQ_CST);
}

/* The fences of sections 7 and 11 by name. A model checker removes one by defining its macro as empty. */
#ifndef ROSPLC_F1
#define ROSPLC_F1() rosplc_fence_release(0)
#endif
#ifndef ROSPLC_F2
#define ROSPLC_F2() rosplc_fence_release(0)
#endif
#ifndef ROSPLC_F3
#define ROSPLC_F3() rosplc_fence_acquire()
#endif
#ifndef ROSPLC_F4
#define ROSPLC_F4() rosplc_fence_acquire()
#endif
#ifndef ROSPLC_F5
#define ROSPLC_F5(size) rosplc_fence_release(size)
#endif
#ifndef ROSPLC_F6
#define ROSPLC_F6(size) rosplc_fence_release(size)
#endif
#ifndef ROSPLC_F7
#define ROSPLC_F7() rosplc_fence_full()
#endif
#ifndef ROSPLC_F8
#define ROSPLC_F8() rosplc_fence_full()
#endif

/* The copy of a record into or out of a slot. It races on purpose: a reader may copy bytes that the writer is
 * changing. In C this is a data race and thus undefined behaviour; it is safe here because
 *   - the copy goes to private memory, and no decision depends on its content before the check after F4, which
 *     rejects every copy that a writer may have touched (M12);
 *   - the compiler cannot move the copy across F3 and F4, F5 and F6, or use it twice: the fences order atomic
 *     accesses to the same object on either side, and the slot is memory that other processes may change;
 *   - a racing load yields some value and never traps on any supported machine.
 * Word-wise atomic accesses would be well defined, but several times slower. A memory-model checker defines
 * this macro as such accesses, and thus verifies the same code without the race. */
#ifndef ROSPLC_COPY_RECORD
#define ROSPLC_COPY_RECORD(to, from, size) memcpy((to), (from), (size))
#endif

#endif
