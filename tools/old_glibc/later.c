// SPDX-License-Identifier: BSD-3-Clause
/// @file Functions of glibc after 2.28 that headers and libstdc++ call, in terms of older ones.
///
/// They become part of a module, hidden: nothing else in the process calls these instead of glibc's.
#include <errno.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <time.h>

/// glibc 2.32. Nobody updates this copy, so it always says that there may be several threads.
char __libc_single_threaded = 0;

// glibc 2.33. Before, they were macros: the first argument is the version of the struct.
#if defined(__x86_64__)
#define STAT_VERSION 1
#else
#define STAT_VERSION 0
#endif
int __xstat64(int version, const char* path, void* status);
int __fxstat64(int version, int file, void* status);
int __lxstat64(int version, const char* path, void* status);
int __fxstatat64(int version, int folder, const char* path, void* status, int flags);
int stat64(const char* path, void* status) { return __xstat64(STAT_VERSION, path, status); }
int fstat64(int file, void* status) { return __fxstat64(STAT_VERSION, file, status); }
int lstat64(const char* path, void* status) { return __lxstat64(STAT_VERSION, path, status); }
int fstatat64(int folder, const char* path, void* status, int flags) {
  return __fxstatat64(STAT_VERSION, folder, path, status, flags);
}
int stat(const char* path, struct stat* status) { return __xstat64(STAT_VERSION, path, status); }
int fstat(int file, struct stat* status) { return __fxstat64(STAT_VERSION, file, status); }
int lstat(const char* path, struct stat* status) { return __lxstat64(STAT_VERSION, path, status); }
int fstatat(int folder, const char* path, struct stat* status, int flags) {
  return __fxstatat64(STAT_VERSION, folder, path, status, flags);
}

// glibc 2.30: waiting until a time on any clock. Older functions know CLOCK_REALTIME alone, which may be set
// while they wait: after a timeout, the clock asked for decides whether to wait on.
static int is_past(const struct timespec* now, const struct timespec* time) {
  return now->tv_sec > time->tv_sec || (now->tv_sec == time->tv_sec && now->tv_nsec >= time->tv_nsec);
}

static int wait_until(int (*wait)(void*, void*, const struct timespec*), void* first, void* second,
                      clockid_t clock, const struct timespec* time) {
  for (;;) {
    struct timespec now;
    struct timespec until;
    if (clock_gettime(clock, &now) != 0 || clock_gettime(CLOCK_REALTIME, &until) != 0) return EINVAL;
    if (clock == CLOCK_REALTIME) {
      until = *time;
    } else {
      until.tv_sec += time->tv_sec - now.tv_sec;
      until.tv_nsec += time->tv_nsec - now.tv_nsec;
      if (until.tv_nsec < 0) {
        until.tv_nsec += 1000000000;
        until.tv_sec -= 1;
      } else if (until.tv_nsec >= 1000000000) {
        until.tv_nsec -= 1000000000;
        until.tv_sec += 1;
      }
    }
    const int status = wait(first, second, &until);
    if (status != ETIMEDOUT || clock_gettime(clock, &now) != 0 || is_past(&now, time)) return status;
  }
}

static int wait_for_condition(void* condition, void* mutex, const struct timespec* time) {
  return pthread_cond_timedwait(condition, mutex, time);
}
static int wait_to_lock(void* mutex, void* none, const struct timespec* time) {
  (void)none;
  return pthread_mutex_timedlock(mutex, time);
}
static int wait_to_read(void* lock, void* none, const struct timespec* time) {
  (void)none;
  return pthread_rwlock_timedrdlock(lock, time);
}
static int wait_to_write(void* lock, void* none, const struct timespec* time) {
  (void)none;
  return pthread_rwlock_timedwrlock(lock, time);
}

int pthread_cond_clockwait(pthread_cond_t* condition, pthread_mutex_t* mutex, clockid_t clock,
                           const struct timespec* time) {
  return wait_until(wait_for_condition, condition, mutex, clock, time);
}
int pthread_mutex_clocklock(pthread_mutex_t* mutex, clockid_t clock, const struct timespec* time) {
  return wait_until(wait_to_lock, mutex, NULL, clock, time);
}
int pthread_rwlock_clockrdlock(pthread_rwlock_t* lock, clockid_t clock, const struct timespec* time) {
  return wait_until(wait_to_read, lock, NULL, clock, time);
}
int pthread_rwlock_clockwrlock(pthread_rwlock_t* lock, clockid_t clock, const struct timespec* time) {
  return wait_until(wait_to_write, lock, NULL, clock, time);
}

// glibc 2.36.
unsigned int arc4random(void) {
  unsigned int number = 0;
  while (getrandom(&number, sizeof number, 0) != (ssize_t)sizeof number) {
  }
  return number;
}

// glibc 2.38: the same functions for C23, which read binary numbers (0b11), too; none of our formats has
// them.
long __isoc23_strtol(const char* text, char** end, int base) { return strtol(text, end, base); }
unsigned long __isoc23_strtoul(const char* text, char** end, int base) { return strtoul(text, end, base); }
long long __isoc23_strtoll(const char* text, char** end, int base) { return strtoll(text, end, base); }
unsigned long long __isoc23_strtoull(const char* text, char** end, int base) {
  return strtoull(text, end, base);
}
int __isoc23_sscanf(const char* text, const char* format, ...) {
  va_list arguments;
  va_start(arguments, format);
  const int found = vsscanf(text, format, arguments);
  va_end(arguments);
  return found;
}
