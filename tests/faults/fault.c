/* Fails the N-th call that changes files below a folder; loaded before the C library with LD_PRELOAD.

   fault_arm(folder, n, how): how is 0 to count alone, SIGKILL for a kill, or an errno that the call fails with. A write
   that a kill meets is half done, in whole pages, as the kernel does it. After ENOSPC the disk stays full: whatever needs room fails from then on.
   fault_seen(): how many such calls there were.

   With FAULT_HANG and FAULT_BELOW in the environment, a call of the name that a file in the folder FAULT_HANG has
   (write, fsync, open, rename, stat) hangs below FAULT_BELOW for as long as that file is there. */

#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

enum { FILES = 65536 };

static char folder[PATH_MAX];
static size_t length;
static long wanted, seen;
static int how, full;
static char below[FILES];

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

void fault_arm(const char *path, long n, int fault) {
    snprintf(folder, sizeof folder, "%s/", path);
    length = strlen(folder);
    wanted = n, how = fault, seen = 0, full = 0;
}

long fault_seen(void) { return seen; }

static const char *hanging;

__attribute__((constructor)) static void begin(void) {
    const char *below = getenv("FAULT_BELOW");
    hanging = getenv("FAULT_HANG");
    if (hanging && below) fault_arm(below, 0, 0);
}

/* Stand still for as long as calls of this name do. */
static void hang(int is_below, const char *call) {
    char flag[PATH_MAX];
    if (!hanging || !is_below) return;
    snprintf(flag, sizeof flag, "%s/%s", hanging, call);
    while (access(flag, F_OK) == 0) usleep(5000);
}

static int inside(int at, const char *path) {
    char whole[2 * PATH_MAX + 2], from[PATH_MAX] = "", link[64];
    if (!length || !path) return 0;
    if (path[0] != '/') {
        snprintf(link, sizeof link, at == AT_FDCWD ? "/proc/self/cwd" : "/proc/self/fd/%d", at);
        ssize_t size = readlink(link, from, sizeof from - 1);
        if (size < 0) return 0;
        from[size] = 0;
    }
    snprintf(whole, sizeof whole, "%s%s%s", from, from[0] ? "/" : "", path);
    return strncmp(whole, folder, length) == 0;
}

/* What the call that is about to be made fails with, or 0; a kill is left to the caller, who may do half of it. */
static int due(int needs_room) {
    if (++seen == wanted) {
        if (how == SIGKILL) return -1;
        full = how == ENOSPC;
        return how;
    }
    return full && needs_room ? ENOSPC : 0;
}

#define FAIL_IF(is_below, needs_room, before_kill)             \
    if (is_below) {                                            \
        int fault = due(needs_room);                           \
        if (fault < 0) {                                       \
            before_kill;                                       \
            kill(getpid(), SIGKILL);                           \
            pause();                                           \
        }                                                      \
        if (fault) {                                           \
            errno = fault;                                     \
            return -1;                                         \
        }                                                      \
    }

#define OPEN(name, at, path, flags, ...)                                                      \
    {                                                                                         \
        mode_t mode = 0;                                                                      \
        if ((flags) & (O_CREAT | O_TMPFILE)) {                                                \
            va_list rest;                                                                     \
            va_start(rest, flags);                                                            \
            mode = va_arg(rest, mode_t);                                                      \
            va_end(rest);                                                                     \
        }                                                                                     \
        int is_below = inside(at, path);                                                      \
        hang(is_below, "open");                                                               \
        FAIL_IF(is_below && ((flags) & (O_WRONLY | O_RDWR | O_CREAT | O_TRUNC)), 1, )         \
        int file = REAL(name)(__VA_ARGS__, mode);                                             \
        if (file >= 0 && file < FILES) below[file] = (char)is_below;                          \
        return file;                                                                          \
    }

int open(const char *path, int flags, ...) OPEN(open, AT_FDCWD, path, flags, path, flags)
int open64(const char *path, int flags, ...) OPEN(open64, AT_FDCWD, path, flags, path, flags)
int openat(int at, const char *path, int flags, ...) OPEN(openat, at, path, flags, at, path, flags)
int openat64(int at, const char *path, int flags, ...) OPEN(openat64, at, path, flags, at, path, flags)

int close(int file) {
    if (file >= 0 && file < FILES) below[file] = 0;
    return REAL(close)(file);
}

#define ON(file) ((file) >= 0 && (file) < FILES && below[file])

#define ON_FILE(type, name, needs_room, half, file, parameters, ...) \
    type name parameters {                                           \
        hang(ON(file), #name);                                       \
        FAIL_IF(ON(file), needs_room, half)                          \
        return REAL(name)(__VA_ARGS__);                              \
    }

#define HALF(call) if (call) {}
#define PAGES(size) ((size) / 2 & ~(size_t)4095)
ON_FILE(ssize_t, write, 1, HALF(REAL(write)(file, data, PAGES(size))), file, (int file, const void *data, size_t size),
        file, data, size)
ON_FILE(ssize_t, pwrite, 1, HALF(REAL(pwrite)(file, data, PAGES(size), to)), file,
        (int file, const void *data, size_t size, off_t to), file, data, size, to)
ON_FILE(ssize_t, pwrite64, 1, HALF(REAL(pwrite64)(file, data, PAGES(size), to)), file,
        (int file, const void *data, size_t size, off64_t to), file, data, size, to)
ON_FILE(ssize_t, writev, 1, , file, (int file, const struct iovec *parts, int count), file, parts, count)
ON_FILE(int, fsync, 0, , file, (int file), file)
ON_FILE(int, fdatasync, 0, , file, (int file), file)
ON_FILE(int, ftruncate, 0, , file, (int file, off_t size), file, size)
ON_FILE(int, ftruncate64, 0, , file, (int file, off64_t size), file, size)
ON_FILE(int, fchmod, 0, , file, (int file, mode_t mode), file, mode)
ON_FILE(ssize_t, copy_file_range, 1, , file,
        (int from, off64_t *at, int file, off64_t *to, size_t size, unsigned flags), from, at, file, to, size, flags)
ssize_t sendfile(int to, int from, off_t *at, size_t size);
ssize_t sendfile64(int to, int from, off64_t *at, size_t size);
ON_FILE(ssize_t, sendfile, 1, , file, (int file, int from, off_t *at, size_t size), file, from, at, size)
ON_FILE(ssize_t, sendfile64, 1, , file, (int file, int from, off64_t *at, size_t size), file, from, at, size)

#define ON_PATH(name, needs_room, at, path, parameters, ...)   \
    int name parameters {                                      \
        int is_below = inside(at, path);                       \
        hang(is_below, #name);                                 \
        FAIL_IF(is_below, needs_room, )                        \
        return REAL(name)(__VA_ARGS__);                        \
    }

ON_PATH(rename, 0, AT_FDCWD, new, (const char *old, const char *new), old, new)
ON_PATH(renameat, 0, to, new, (int at, const char *old, int to, const char *new), at, old, to, new)
ON_PATH(unlink, 0, AT_FDCWD, path, (const char *path), path)
ON_PATH(unlinkat, 0, at, path, (int at, const char *path, int flags), at, path, flags)
ON_PATH(rmdir, 0, AT_FDCWD, path, (const char *path), path)
ON_PATH(mkdir, 1, AT_FDCWD, path, (const char *path, mode_t mode), path, mode)
ON_PATH(mkdirat, 1, at, path, (int at, const char *path, mode_t mode), at, path, mode)
ON_PATH(link, 1, AT_FDCWD, new, (const char *old, const char *new), old, new)
ON_PATH(linkat, 1, to, new, (int at, const char *old, int to, const char *new, int flags), at, old, to, new, flags)
ON_PATH(symlink, 1, AT_FDCWD, path, (const char *target, const char *path), target, path)
ON_PATH(symlinkat, 1, at, path, (const char *target, int at, const char *path), target, at, path)
ON_PATH(chmod, 0, AT_FDCWD, path, (const char *path, mode_t mode), path, mode)
ON_PATH(fchmodat, 0, at, path, (int at, const char *path, mode_t mode, int flags), at, path, mode, flags)

#define STAT(name, at, path, parameters, ...)      \
    int name parameters {                          \
        hang(hanging && inside(at, path), "stat"); \
        return REAL(name)(__VA_ARGS__);            \
    }

STAT(stat, AT_FDCWD, path, (const char *path, struct stat *into), path, into)
STAT(lstat, AT_FDCWD, path, (const char *path, struct stat *into), path, into)
STAT(fstatat, at, path, (int at, const char *path, struct stat *into, int flags), at, path, into, flags)
STAT(stat64, AT_FDCWD, path, (const char *path, struct stat64 *into), path, into)
STAT(lstat64, AT_FDCWD, path, (const char *path, struct stat64 *into), path, into)
STAT(fstatat64, at, path, (int at, const char *path, struct stat64 *into, int flags), at, path, into, flags)
STAT(statvfs, AT_FDCWD, path, (const char *path, struct statvfs *into), path, into)
STAT(statvfs64, AT_FDCWD, path, (const char *path, struct statvfs64 *into), path, into)
