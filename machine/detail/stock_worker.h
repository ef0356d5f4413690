// The stock in a thread of its own, so that the protocol never waits long for material to be removed.
#pragma once

#include <atomic>
#include <condition_variable>
#include <deque>
#include <exception>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "cam/cutter.h"
#include "machine/stock_model.h"

namespace lightmill::detail {

/// Moves go in from one thread, in order; the stock sees them in that order. A bounded queue: who is too fast waits.
class StockWorker {
 public:
  StockWorker(const Blank& blank, const StockOptions& options);
  ~StockWorker();
  StockWorker(const StockWorker&) = delete;
  StockWorker& operator=(const StockWorker&) = delete;

  void set_cutter(const Cutter& cutter);
  void move(const std::vector<SweptMove>& pieces);
  /// The queue is three quarters full: who can wait without harm should.
  [[nodiscard]] bool behind() const { return waiting_.load() >= kMostBatches * 3 / 4; }
  /// The faults from here on belong to the program of this name.
  void begin_program(const std::string& name);
  /// Waits until all moves are cut. Rethrows what the stock has thrown.
  void finish();
  /// finish() first.
  [[nodiscard]] const std::vector<Fault>& faults() const { return faults_; }
  [[nodiscard]] const StockModel& stock() const { return stock_; }

 private:
  struct Batch {
    std::vector<SweptMove> moves;
    // What happens after the moves.
    bool change_cutter = false;
    Cutter cutter;
    bool next_program = false;
    std::string program;
    bool flush = false;
  };
  static constexpr std::size_t kMostBatches = 128;  ///< about 40 MB of moves
  void hand_over();
  void run();
  void collect_faults();

  StockModel stock_;
  std::vector<Fault> faults_;  ///< written by the thread, read after finish()
  std::size_t faults_taken_ = 0;
  std::string program_;
  Batch filling_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Batch> queue_;
  std::atomic<std::size_t> waiting_{0};  ///< size of queue_
  bool busy_ = false, ending_ = false;
  std::exception_ptr failure_;
  std::thread thread_;
};

}  // namespace lightmill::detail
