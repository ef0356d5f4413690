#include "machine/detail/stock_worker.h"

#include <utility>

namespace lightmill::detail {

namespace {
constexpr std::size_t kBatch = 2048;  ///< moves that are handed over at once
}  // namespace

StockWorker::StockWorker(const Blank& blank, const StockOptions& options)
    : stock_(blank, options), thread_([this] { run(); }) {
  filling_.moves.reserve(kBatch);
}

StockWorker::~StockWorker() {
  {
    const std::lock_guard lock(mutex_);
    ending_ = true;
    queue_.clear();
  }
  changed_.notify_all();
  thread_.join();
}

void StockWorker::hand_over() {
  std::unique_lock lock(mutex_);
  changed_.wait(lock, [this] { return queue_.size() < kMostBatches; });
  queue_.push_back(std::move(filling_));
  waiting_ = queue_.size();
  filling_ = {};
  lock.unlock();
  changed_.notify_all();
  filling_.moves.reserve(kBatch);
}

void StockWorker::set_cutter(const Cutter& cutter) {
  filling_.change_cutter = true;
  filling_.cutter = cutter;
  hand_over();
}

void StockWorker::begin_program(const std::string& name) {
  filling_.next_program = true;
  filling_.program = name;
  hand_over();
}

void StockWorker::move(const std::vector<SweptMove>& pieces) {
  filling_.moves.insert(filling_.moves.end(), pieces.begin(), pieces.end());
  if (filling_.moves.size() >= kBatch) hand_over();
}

void StockWorker::finish() {
  filling_.flush = true;
  hand_over();
  std::unique_lock lock(mutex_);
  changed_.wait(lock, [this] { return queue_.empty() && !busy_; });
  if (failure_) std::rethrow_exception(failure_);
}

void StockWorker::collect_faults() {
  const std::vector<Fault>& all = stock_.faults();
  for (; faults_taken_ < all.size(); ++faults_taken_) {
    faults_.push_back(all[faults_taken_]);
    if (faults_.back().program.empty()) faults_.back().program = program_;
  }
}

void StockWorker::run() {
  std::unique_lock lock(mutex_);
  for (;;) {
    changed_.wait(lock, [this] { return ending_ || !queue_.empty(); });
    if (ending_) return;
    const Batch batch = std::move(queue_.front());
    queue_.pop_front();
    waiting_ = queue_.size();
    busy_ = true;
    const bool failed = failure_ != nullptr;
    lock.unlock();
    changed_.notify_all();
    std::exception_ptr failure;
    if (!failed) {
      try {
        for (const SweptMove& piece : batch.moves) stock_.move(piece);
        if (batch.change_cutter || batch.next_program || batch.flush) {
          stock_.flush();
          collect_faults();
        }
        if (batch.change_cutter) stock_.set_cutter(batch.cutter);
        if (batch.next_program) program_ = batch.program;
      } catch (...) {
        failure = std::current_exception();
      }
    }
    lock.lock();
    if (failure) failure_ = failure;
    busy_ = false;
    changed_.notify_all();
  }
}

}  // namespace lightmill::detail
