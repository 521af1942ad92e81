-- Readers of the signal database, for wrk: wrk ... -s sopdb_load.lua URL -- FILE MEAN_DELAY_MS TOKEN
-- FILE has a source's id a line. Of a hundred requests 60 are for one source now, 20 for a page of the list, 10 for
-- what is near a place, 10 for one source at a time of the coming week. With a mean delay above zero each connection waits an
-- exponential time before a request, so that many connections ask at about the rate connections / delay.

local ids, delay_ms, headers = {}, 0, {}

function init(args)
  for line in io.lines(args[1]) do ids[#ids + 1] = line end
  delay_ms = tonumber(args[2])
  headers["Authorization"] = "Bearer " .. args[3]
  math.randomseed(tonumber(args[4]))
end

function delay()
  if delay_ms <= 0 then return 0 end
  return math.floor(-delay_ms * math.log(1 - math.random()) + 0.5)
end

function request()
  local dice = math.random(100)
  local path = "/v1/sources/" .. ids[math.random(#ids)]
  if dice > 90 then
    path = path .. os.date("!?at=%Y-%m-%dT%H:%M:%SZ", os.time() + math.random(7 * 86400))
  elseif dice > 80 then
    path = string.format("/v1/sources?near=%.1f,%.1f&radius_m=5000&limit=20", 60 + math.random(), 24 + 2 * math.random())
  elseif dice > 60 then
    path = "/v1/sources?limit=50"
  end
  return wrk.format("GET", path, headers)
end

function done(summary, latency, requests)
  io.write(string.format(
    '\n{"requests": %d, "seconds": %.6f, "p50_ms": %.3f, "p90_ms": %.3f, "p99_ms": %.3f, "max_ms": %.3f, '
      .. '"refused": %d, "errors": %d}\n',
    summary.requests, summary.duration / 1e6, latency:percentile(50) / 1e3, latency:percentile(90) / 1e3,
    latency:percentile(99) / 1e3, latency.max / 1e3, summary.errors.status,
    summary.errors.connect + summary.errors.read + summary.errors.write + summary.errors.timeout))
end
