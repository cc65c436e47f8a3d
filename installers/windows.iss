; Installer for Windows, by Inno Setup 6, of the folder that `py dev.py app` makes.
;   py dev.py app
;   iscc /DVersion=0.1.0 installers\windows.iss
; It has never been run. It needs no administrator: the program goes to the user's own folder.
#ifndef Version
  #error Name the version: iscc /DVersion=0.1.0 installers\windows.iss
#endif

[Setup]
AppId=PFWD
AppName=PFWD
AppVersion={#Version}
AppPublisher=The PFWD contributors
DefaultDirName={autopf}\PFWD
DefaultGroupName=PFWD
DisableProgramGroupPage=yes
PrivilegesRequired=lowest
ArchitecturesAllowed=x64compatible
ArchitecturesInstallIn64BitMode=x64compatible
ChangesEnvironment=yes
LicenseFile=..\LICENSE
OutputDir=..\dist
OutputBaseFilename=pfwd-{#Version}-windows
Compression=lzma2
SolidCompression=yes
UninstallDisplayName=PFWD {#Version}

[Tasks]
Name: path; Description: "Let the command pfwd be typed in any folder (adds it to PATH)"

[Files]
Source: "..\dist\pfwd\*"; DestDir: "{app}"; Flags: recursesubdirs ignoreversion

[Icons]
; A window that stays open: the first screen explains the commands.
Name: "{group}\PFWD"; Filename: "{cmd}"; Parameters: "/K ""{app}\pfwd.exe"""; WorkingDir: "{userdocs}"
Name: "{group}\PFWD demo"; Filename: "{app}\pfwd.exe"; Parameters: "demo"; WorkingDir: "{userdocs}"

[Registry]
Root: HKCU; Subkey: "Environment"; ValueType: expandsz; ValueName: "Path"; \
  ValueData: "{olddata};{app}"; Tasks: path; Check: IsNotOnPath

[Code]
function IsNotOnPath: Boolean;
var
  Path: string;
begin
  if not RegQueryStringValue(HKEY_CURRENT_USER, 'Environment', 'Path', Path) then
    Path := '';
  Result := Pos(';' + Uppercase(ExpandConstant('{app}')) + ';', ';' + Uppercase(Path) + ';') = 0;
end;
