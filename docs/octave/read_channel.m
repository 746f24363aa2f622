% Delays, angles and powers of a channel file in Octave, which needs its netcdf package:
%   octave read_channel.m out/campus_arena/channel/stop_000.nc
% In MATLAB the same is ncread(file, "/channel/delay_s"). Axes come in reverse order in both.
pkg load netcdf
file = argv(){end};

nc = netcdf_open(file, "NC_NOWRITE");
group = netcdf_inqNcid(nc, "channel");
read = @(name) netcdf_getVar(group, netcdf_inqVarID(group, name));
delay_s = read("delay_s");
aod_deg = rad2deg(read("aod_azimuth_rad"));
aoa_deg = rad2deg(read("aoa_azimuth_rad"));
power_dbm = read("power_dbm");
covariance = read("covariance");  % parameter2 x parameter x path
netcdf_close(nc);

printf("%d paths\n", numel(delay_s));
for path = 1:numel(delay_s)
  printf("%8.3f ns +- %.3f  %7.2f deg  %7.2f deg  %6.1f dBm\n", 1e9 * delay_s(path), ...
         1e9 * sqrt(covariance(1, 1, path)), aod_deg(path), aoa_deg(path), power_dbm(path));
end
