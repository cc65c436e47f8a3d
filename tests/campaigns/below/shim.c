/* Faults below all code: stands between a program and the C library (LD_PRELOAD) and makes the n-th
 * call on the files of one folder fail, or do a part of its work, or be slow.
 *
 * The fault is described by the environment variable PFWD_BELOW, or by a call of pfwd_below_arm, as
 * "roots=/a:/b|state=FILE|log=FILE|calls=MASK|kinds=MASK|at=N|times=N|error=N|mode=N|amount=N".
 * The first root is a survey, the others are folders of surveys. The state is a small file that all processes of a run share: so the n-th call is counted over a
 * program and its children, and whoever watches reads there whether the fault fired.
 */
#define _GNU_SOURCE
#include <dirent.h>
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

/* In the order of CALLS, KINDS and MODES in shim.py. */
enum call {
    OPEN, CREATE, READ, WRITE, FSYNC, FDATASYNC, TRUNCATE, RENAME, LINK, UNLINK, MKDIR, STAT, FSTAT,
    LOCK, LIST, CLOSE, SPACE, CALLS
};
static const char *const call_names[CALLS] = {
    "open", "create", "read", "write", "fsync", "fdatasync", "truncate", "rename", "link", "unlink",
    "mkdir", "stat", "fstat", "lock", "list", "close", "space"};
enum kind {
    JOURNAL, LEDGER, DROPS, RESULTS, CAPTURES, LOCKS, LOG, RESERVE, DAMAGED, FOLDER, OTHER, KINDS
};
static const char *const kind_names[KINDS] = {
    "journal", "ledger", "drops", "results", "captures", "locks", "log", "reserve", "damaged",
    "folder", "other"};
enum mode { ERROR, TORN, SHORT, DONE, SLOW, FORGET };

struct state {
    uint64_t matched, fired, counts[CALLS][KINDS];
};

#define MOST_ROOTS 4
static struct {
    char roots[MOST_ROOTS][PATH_MAX];
    int root_count;
    char log[PATH_MAX];
    uint64_t calls, kinds, at, times, amount;
    int error, mode;
    struct state *state;
} config;

/* ---- what to do ---- */

static uint64_t number(const char *text, const char *key, uint64_t otherwise)
{
    char *found = strstr(text, key);
    return found ? strtoull(found + strlen(key), NULL, 0) : otherwise;
}

static int word(const char *text, const char *key, char *target, size_t size)
{
    const char *found = strstr(text, key);
    if (!found)
        return 0;
    found += strlen(key);
    size_t length = strcspn(found, "|");
    if (length >= size)
        return 0;
    memcpy(target, found, length);
    target[length] = 0;
    return 1;
}

/* 0 when the fault that the text describes is in force; an empty text ends all faults. */
int pfwd_below_arm(const char *text)
{
    char path[PATH_MAX], roots[MOST_ROOTS * PATH_MAX];
    struct state *before = config.state;
    config.state = NULL;
    if (before)
        munmap(before, sizeof *before);
    if (!text || !*text)
        return 0;
    if (!word(text, "roots=", roots, sizeof roots) || !word(text, "|state=", path, sizeof path) ||
        !word(text, "|log=", config.log, sizeof config.log))
        return -1;
    config.root_count = 0;
    char *rest = roots, *root;
    while ((root = strsep(&rest, ":")) && config.root_count < MOST_ROOTS)
        if (*root && strlen(root) < PATH_MAX)
            strcpy(config.roots[config.root_count++], root);
    config.calls = number(text, "|calls=", 0);
    config.kinds = number(text, "|kinds=", 0);
    config.at = number(text, "|at=", 0);
    config.times = number(text, "|times=", 1);
    config.amount = number(text, "|amount=", 0);
    config.error = (int)number(text, "|error=", EIO);
    config.mode = (int)number(text, "|mode=", ERROR);
    int fd = (int)syscall(SYS_openat, AT_FDCWD, path, O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    if (fd < 0)
        return -1;
    void *shared = MAP_FAILED;
    if (!syscall(SYS_ftruncate, fd, (long)sizeof(struct state)))
        shared = mmap(NULL, sizeof(struct state), PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
    syscall(SYS_close, fd);
    if (shared == MAP_FAILED)
        return -1;
    config.state = shared;
    return 0;
}

__attribute__((constructor)) static void begin(void)
{
    pfwd_below_arm(getenv("PFWD_BELOW"));
}

/* ---- which file ---- */

static int begins(const char *text, const char *with)
{
    return strncmp(text, with, strlen(with)) == 0;
}

static enum kind kind_of(const char *name)
{
    static const char *const folders[] = {"", "journal", "drops", "results", "captures", "damaged",
                                          "log"};
    for (size_t n = 0; n < sizeof folders / sizeof *folders; n++)
        if (!strcmp(name, folders[n]))
            return FOLDER;
    if (begins(name, "journal/"))
        return JOURNAL;
    if (begins(name, "acknowledged") || begins(name, ".acknowledged"))
        return LEDGER;
    if (begins(name, "drops/"))
        return DROPS;
    if (begins(name, "results/"))
        return RESULTS;
    if (begins(name, "captures/"))
        return CAPTURES;
    if (begins(name, "damaged/"))
        return DAMAGED;
    if (begins(name, "log/"))
        return LOG;
    if (begins(name, "reserve") || begins(name, ".reserve"))
        return RESERVE;
    if (strstr(name, ".lock") || strstr(name, "writer.txt"))
        return LOCKS;
    return OTHER;
}

/* The kind of the file at an absolute path; -1 when it is none of ours. */
static int kind_at(const char *path)
{
    for (int n = 0; n < config.root_count; n++) {
        size_t length = strlen(config.roots[n]);
        if (strncmp(path, config.roots[n], length) || (path[length] && path[length] != '/'))
            continue;
        const char *name = path[length] ? path + length + 1 : "";
        if (n > 0) { /* a folder of surveys, not a survey */
            name = strchr(name, '/');
            name = name ? name + 1 : "";
        }
        return kind_of(name);
    }
    return -1;
}

static int path_of_descriptor(int fd, char *path)
{
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    long length = syscall(SYS_readlinkat, AT_FDCWD, link, path, PATH_MAX - 1);
    if (length <= 0)
        return 0;
    path[length] = 0;
    char *deleted = strstr(path, " (deleted)");
    if (deleted)
        *deleted = 0;
    return path[0] == '/';
}

static int absolute(int directory, const char *name, char *path)
{
    if (!name)
        return 0;
    if (name[0] == '/') {
        if (strlen(name) >= PATH_MAX)
            return 0;
        strcpy(path, name);
    } else {
        char folder[PATH_MAX];
        if (directory == AT_FDCWD ? syscall(SYS_getcwd, folder, sizeof folder) <= 0
                                  : !path_of_descriptor(directory, folder))
            return 0;
        if (snprintf(path, PATH_MAX, "%s/%s", folder, name) >= PATH_MAX)
            return 0;
    }
    size_t length = strlen(path);
    while (length > 1 && path[length - 1] == '/')
        path[--length] = 0;
    return 1;
}

/* ---- whether now ---- */

static void note(enum call call, int kind, const char *path, uint64_t count)
{
    char line[PATH_MAX + 160];
    int length = snprintf(line, sizeof line, "%d %s %s %llu error %d mode %d %s\n", getpid(),
                          call_names[call], kind_names[kind], (unsigned long long)count,
                          config.error, config.mode, path);
    int fd = (int)syscall(SYS_openat, AT_FDCWD, config.log, O_WRONLY | O_APPEND | O_CREAT | O_CLOEXEC,
                          0600);
    if (fd < 0)
        return;
    syscall(SYS_write, fd, line, (size_t)length);
    syscall(SYS_close, fd);
}

static int fires(enum call call, const char *path)
{
    int kind = kind_at(path);
    if (kind < 0)
        return 0;
    __atomic_add_fetch(&config.state->counts[call][kind], 1, __ATOMIC_SEQ_CST);
    if (!(config.calls >> call & 1) || !(config.kinds >> kind & 1))
        return 0;
    uint64_t count = __atomic_add_fetch(&config.state->matched, 1, __ATOMIC_SEQ_CST);
    if (!config.at || count < config.at || count - config.at >= config.times)
        return 0;
    __atomic_add_fetch(&config.state->fired, 1, __ATOMIC_SEQ_CST);
    note(call, kind, path, count);
    if (config.mode == SLOW) {
        struct timespec pause = {(time_t)(config.amount / 1000),
                                 (long)(config.amount % 1000) * 1000000L};
        nanosleep(&pause, NULL);
        return 0;
    }
    return 1;
}

static int fires_at(enum call call, int directory, const char *name)
{
    char path[PATH_MAX];
    return config.state && absolute(directory, name, path) && fires(call, path);
}

static int fires_on(enum call call, int fd)
{
    char path[PATH_MAX];
    if (!config.state || fd < 0)
        return 0;
    int before = errno, found = path_of_descriptor(fd, path);
    errno = before;
    return found && fires(call, path);
}

static int refuse(void)
{
    errno = config.error;
    return -1;
}

/* ---- what a disk forgets when a sync fails: all that was appended since the last good one ----
 *
 * The system drops the pages that it could not write and calls the next sync a success; the bytes are
 * zeros when the file is read again.
 */

#define MOST_FILES 512
static struct known_file {
    dev_t device;
    ino_t inode;
    off_t synced;
} known[MOST_FILES];
static int known_count, known_busy;

static struct known_file *known_file(const struct stat *found)
{
    for (int n = 0; n < known_count; n++)
        if (known[n].device == found->st_dev && known[n].inode == found->st_ino)
            return &known[n];
    if (known_count == MOST_FILES)
        return NULL;
    known[known_count] = (struct known_file){found->st_dev, found->st_ino, 0};
    return &known[known_count++];
}

enum event { OPENED_NOW, SYNCED, FAILED };

static void follow(enum event event, int fd)
{
    struct stat found;
    if (!config.state || config.mode != FORGET || fd < 0)
        return;
    int before = errno;
    char path[PATH_MAX];
    if (path_of_descriptor(fd, path) && kind_at(path) >= 0 &&
        !syscall(SYS_newfstatat, fd, "", &found, AT_EMPTY_PATH) && S_ISREG(found.st_mode)) {
        while (__atomic_exchange_n(&known_busy, 1, __ATOMIC_ACQUIRE))
            ;
        int count = known_count;
        struct known_file *file = known_file(&found);
        int is_new = count != known_count;
        if (file && event == FAILED) {
            /* The length is known to the file system, the pages are not. */
            static const char zeros[4096];
            for (off_t at = file->synced; at < found.st_size; at += (off_t)sizeof zeros) {
                size_t left = (size_t)(found.st_size - at);
                syscall(SYS_pwrite64, fd, zeros, left < sizeof zeros ? left : sizeof zeros, at);
            }
        } else if (file && (event == SYNCED || is_new || found.st_size < file->synced)) {
            file->synced = found.st_size;
        }
        __atomic_store_n(&known_busy, 0, __ATOMIC_RELEASE);
    }
    errno = before;
}

/* A fault of a call that has no parts: the call itself may have been done. */
#define NEXT(name) \
    static __typeof__(&name) next; \
    if (!next) \
    next = (__typeof__(&name))dlsym(RTLD_NEXT, #name)
#define ANSWER(fired, done) \
    do { \
        if (!(fired)) \
            return done; \
        if (config.mode == DONE) \
            (void)!(done); \
        return refuse(); \
    } while (0)

/* ---- the calls ---- */

#define MODE_OF(flags) \
    mode_t mode = 0; \
    if (((flags) & O_CREAT) || ((flags) & O_TMPFILE) == O_TMPFILE) { \
        va_list more; \
        va_start(more, flags); \
        mode = va_arg(more, mode_t); \
        va_end(more); \
    }
#define OPENING(flags) ((flags) & O_CREAT ? CREATE : OPEN)

/* An open that is refused although it was done leaves no descriptor behind. */
static int opened(int fired, int fd)
{
    if (!fired) {
        follow(OPENED_NOW, fd);
        return fd;
    }
    if (fd >= 0)
        syscall(SYS_close, fd);
    return refuse();
}

#define OPENED(fired, done) \
    do { \
        int is_fired = (fired); \
        return is_fired && config.mode != DONE ? refuse() : opened(is_fired, done); \
    } while (0)

int open(const char *path, int flags, ...)
{
    NEXT(open);
    MODE_OF(flags)
    OPENED(fires_at(OPENING(flags), AT_FDCWD, path), next(path, flags, mode));
}

int openat(int directory, const char *path, int flags, ...)
{
    NEXT(openat);
    MODE_OF(flags)
    OPENED(fires_at(OPENING(flags), directory, path), next(directory, path, flags, mode));
}

int close(int fd)
{
    NEXT(close);
    if (!fires_on(CLOSE, fd))
        return next(fd);
    next(fd); /* the descriptor is gone, whatever the answer is */
    return refuse();
}

ssize_t read(int fd, void *data, size_t size)
{
    NEXT(read);
    if (!fires_on(READ, fd))
        return next(fd, data, size);
    if (config.mode == SHORT)
        return next(fd, data, size < config.amount ? size : config.amount);
    return refuse();
}

/* How much of a write is done: amount, or a part of it when it is a share of a thousand. */
static size_t part(size_t size)
{
    size_t amount = config.amount >= 1000000 ? size * (config.amount - 1000000) / 1000 : config.amount;
    return amount < size ? amount : size;
}

#define WRITTEN(size, whole, some) \
    do { \
        if (!fires_on(WRITE, fd)) \
            return whole; \
        if (config.mode == DONE) \
            (void)!(whole); \
        else if (config.mode == SHORT && part(size)) \
            return some; \
        else if (config.mode == TORN) \
            (void)!(some); \
        return refuse(); \
    } while (0)

ssize_t write(int fd, const void *data, size_t size)
{
    NEXT(write);
    WRITTEN(size, next(fd, data, size), next(fd, data, part(size)));
}

ssize_t pwrite(int fd, const void *data, size_t size, off_t offset)
{
    NEXT(pwrite);
    WRITTEN(size, next(fd, data, size, offset), next(fd, data, part(size), offset));
}

ssize_t writev(int fd, const struct iovec *pieces, int count)
{
    NEXT(writev);
    WRITTEN(count ? pieces[0].iov_len : 0, next(fd, pieces, count),
            syscall(SYS_write, fd, pieces[0].iov_base, part(pieces[0].iov_len)));
}

static int synced(enum call call, int fd, int (*next)(int))
{
    if (fires_on(call, fd)) {
        follow(FAILED, fd);
        if (config.mode == DONE)
            (void)!next(fd);
        return refuse();
    }
    int answer = next(fd);
    if (!answer)
        follow(SYNCED, fd);
    return answer;
}

int fsync(int fd)
{
    NEXT(fsync);
    return synced(FSYNC, fd, next);
}

int fdatasync(int fd)
{
    NEXT(fdatasync);
    return synced(FDATASYNC, fd, next);
}

int ftruncate(int fd, off_t size)
{
    NEXT(ftruncate);
    ANSWER(fires_on(TRUNCATE, fd), next(fd, size));
}

int truncate(const char *path, off_t size)
{
    NEXT(truncate);
    ANSWER(fires_at(TRUNCATE, AT_FDCWD, path), next(path, size));
}

/* A file that gets another name counts where it goes, else where it was. */
static int fires_between(enum call call, int from, const char *old, int to, const char *new)
{
    char path[PATH_MAX];
    if (!config.state)
        return 0;
    if (absolute(to, new, path) && kind_at(path) >= 0)
        return fires(call, path);
    return absolute(from, old, path) && fires(call, path);
}

int rename(const char *old, const char *new)
{
    NEXT(rename);
    ANSWER(fires_between(RENAME, AT_FDCWD, old, AT_FDCWD, new), next(old, new));
}

int renameat(int from, const char *old, int to, const char *new)
{
    NEXT(renameat);
    ANSWER(fires_between(RENAME, from, old, to, new), next(from, old, to, new));
}

int renameat2(int from, const char *old, int to, const char *new, unsigned flags)
{
    NEXT(renameat2);
    ANSWER(fires_between(RENAME, from, old, to, new), next(from, old, to, new, flags));
}

int link(const char *old, const char *new)
{
    NEXT(link);
    ANSWER(fires_between(LINK, AT_FDCWD, old, AT_FDCWD, new), next(old, new));
}

int linkat(int from, const char *old, int to, const char *new, int flags)
{
    NEXT(linkat);
    ANSWER(fires_between(LINK, from, old, to, new), next(from, old, to, new, flags));
}

int unlink(const char *path)
{
    NEXT(unlink);
    ANSWER(fires_at(UNLINK, AT_FDCWD, path), next(path));
}

int unlinkat(int directory, const char *path, int flags)
{
    NEXT(unlinkat);
    ANSWER(fires_at(UNLINK, directory, path), next(directory, path, flags));
}

int mkdir(const char *path, mode_t mode)
{
    NEXT(mkdir);
    ANSWER(fires_at(MKDIR, AT_FDCWD, path), next(path, mode));
}

int mkdirat(int directory, const char *path, mode_t mode)
{
    NEXT(mkdirat);
    ANSWER(fires_at(MKDIR, directory, path), next(directory, path, mode));
}

int stat(const char *path, struct stat *found)
{
    NEXT(stat);
    ANSWER(fires_at(STAT, AT_FDCWD, path), next(path, found));
}

int lstat(const char *path, struct stat *found)
{
    NEXT(lstat);
    ANSWER(fires_at(STAT, AT_FDCWD, path), next(path, found));
}

int fstat(int fd, struct stat *found)
{
    NEXT(fstat);
    ANSWER(fires_on(FSTAT, fd), next(fd, found));
}

int fstatat(int directory, const char *path, struct stat *found, int flags)
{
    NEXT(fstatat);
    ANSWER(fires_at(STAT, directory, path), next(directory, path, found, flags));
}

int flock(int fd, int operation)
{
    static int (*next)(int, int);
    if (!next)
        next = (int (*)(int, int))dlsym(RTLD_NEXT, "flock");
    ANSWER(fires_on(LOCK, fd), next(fd, operation));
}

DIR *opendir(const char *path)
{
    NEXT(opendir);
    if (!fires_at(LIST, AT_FDCWD, path))
        return next(path);
    refuse();
    return NULL;
}

int statvfs(const char *path, struct statvfs *found)
{
    NEXT(statvfs);
    ANSWER(fires_at(SPACE, AT_FDCWD, path), next(path, found));
}

#ifdef __GLIBC__ /* the same under the names of large files */

int open64(const char *path, int flags, ...)
{
    NEXT(open64);
    MODE_OF(flags)
    OPENED(fires_at(OPENING(flags), AT_FDCWD, path), next(path, flags, mode));
}

int openat64(int directory, const char *path, int flags, ...)
{
    NEXT(openat64);
    MODE_OF(flags)
    OPENED(fires_at(OPENING(flags), directory, path), next(directory, path, flags, mode));
}

ssize_t pwrite64(int fd, const void *data, size_t size, off64_t offset)
{
    NEXT(pwrite64);
    WRITTEN(size, next(fd, data, size, offset), next(fd, data, part(size), offset));
}

int ftruncate64(int fd, off64_t size)
{
    NEXT(ftruncate64);
    ANSWER(fires_on(TRUNCATE, fd), next(fd, size));
}

int truncate64(const char *path, off64_t size)
{
    NEXT(truncate64);
    ANSWER(fires_at(TRUNCATE, AT_FDCWD, path), next(path, size));
}

int stat64(const char *path, struct stat64 *found)
{
    NEXT(stat64);
    ANSWER(fires_at(STAT, AT_FDCWD, path), next(path, found));
}

int lstat64(const char *path, struct stat64 *found)
{
    NEXT(lstat64);
    ANSWER(fires_at(STAT, AT_FDCWD, path), next(path, found));
}

int fstat64(int fd, struct stat64 *found)
{
    NEXT(fstat64);
    ANSWER(fires_on(FSTAT, fd), next(fd, found));
}

int fstatat64(int directory, const char *path, struct stat64 *found, int flags)
{
    NEXT(fstatat64);
    ANSWER(fires_at(STAT, directory, path), next(directory, path, found, flags));
}

int statvfs64(const char *path, struct statvfs64 *found)
{
    NEXT(statvfs64);
    ANSWER(fires_at(SPACE, AT_FDCWD, path), next(path, found));
}
#endif
